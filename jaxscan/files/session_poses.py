"""`[poses]` of a session: photographs of the board for which a robot, a gantry or a tracker gives a pose each."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, Final

import numpy as np

from jaxscan.axis_details import POSES
from jaxscan.files.listing import files_of
from jaxscan.files.pose_table import named_table, read_pose_table
from jaxscan.files.settings import relative_name
from jaxscan.files.table import Table
from jaxscan.geometry import Pose
from jaxscan.rig import CARRIED_BY

_FEWEST: Final = 3
_KEYS: Final = ("images", "file", "moves", "sigma_mm", "sigma_deg", "stripes")


@dataclass(frozen=True)
class PosedImages:
    """Photographs of a board that stays where it is on base or hand, and the pose that is given for each.

    Attributes:
        images: the photographs, the last of the session's views.
        file: the table of poses.
        poses: T_base_hand of each, stacked, mm.
        moves: "head", the camera is on the hand, or "object", the board is.
        sigma_mm: σ of a given position along each axis, where it is known.
        sigma_deg: σ of a given rotation about each axis, where it is known.
    """

    images: tuple[Path, ...]
    file: Path
    poses: Pose[np.ndarray]
    moves: str
    sigma_mm: float | None = None
    sigma_deg: float | None = None

    def given(self) -> dict[Path, Pose[np.ndarray]]:
        """The pose of each photograph."""
        each = zip(self.images, self.poses.rotation, self.poses.translation, strict=True)
        return {path: Pose(rotation, translation) for path, rotation, translation in each}


def read_posed_images(table: Table) -> tuple[PosedImages, Table] | None:
    """What a session says of given poses, and the table with it; None where it says nothing.

    Raises:
        InputError: file, key, value, and how to fix it.
    """
    if POSES not in table:
        return None
    posed = table.table(POSES, f"[{POSES}] ").only(*_KEYS)
    images = files_of(posed, "images")
    if len(images) < _FEWEST:
        raise posed.error("images", f"{len(images)} photographs: three or more are needed, 10 to 20 are good")
    file = named_table(posed, "file", "photograph")
    moves = posed.string("moves", choices=tuple(CARRIED_BY))
    sigma = {key: _sigma(posed, key) for key in ("sigma_mm", "sigma_deg")}
    return PosedImages(images, file, read_pose_table(file, images), moves, **sigma), posed


def posed_values(posed: PosedImages, folder: Path, stripes: Mapping[str, Any]) -> dict[str, Any]:
    """The inverse of `read_posed_images`: the keys of `[poses]`, with those of its stripes."""
    values: dict[str, Any] = {"images": [relative_name(path, folder) for path in posed.images], **stripes}
    values |= {"file": relative_name(posed.file, folder), "moves": posed.moves}
    sigma = {"sigma_mm": posed.sigma_mm, "sigma_deg": posed.sigma_deg}
    return values | {key: value for key, value in sigma.items() if value is not None}


def _sigma(table: Table, key: str) -> float | None:
    if key not in table:
        return None
    if (sigma := table.number(key)) <= 0:
        raise table.error(key, "must be above 0; leave it out, and it is found from the photographs")
    return sigma
