"""`scan.toml`: the photographs of an object on its way through the light, and where each axis stood for each."""

import os
import warnings
from collections.abc import Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Final

from jaxscan.axis_details import POSES, is_detail
from jaxscan.files.axes import Positions, Rules, axes_values, read_axes
from jaxscan.files.listing import files_of, name_some, natural_key, repeated_files_of
from jaxscan.files.place_checks import PlaceCheck, check_values, read_checks
from jaxscan.files.settings import (
    read_listing,
    read_stripe_settings,
    relative_name,
    stripe_values,
    write_toml,
)
from jaxscan.files.table import PassedOverWarning, Table
from jaxscan.images import StripeSettings

SCAN_FILE: Final = "scan.toml"
# What a session's [laser] has besides.
_OF_THE_RIG: Final = ("sheet", "axis", "stripes", "stripe_steps")
VIDEO_ENDINGS: Final = (".mp4", ".avi", ".mov", ".mkv", ".webm", ".m4v", ".mpg", ".mpeg", ".wmv")


@dataclass(frozen=True)
class Scan:
    """A scan.

    Attributes:
        path: its TOML file.
        laser: how to look for the stripe.
        frames: the photographs in their order; a scan cut off before its first has none. Empty for a video.
        video: the video file whose frames replace `frames`.
        axes: for each axis its position at each frame, motor steps; empty for a video with `rules`.
        rules: for a video whose number of frames is not known before it is decoded: for each axis its start and its
            increment from one frame to the next. Empty where `axes` has the positions.
        backgrounds: the scene with the laser off: none, one for all frames, or one for each.
        exposures_s: exposure time of each frame, where it matters.
        name: what was scanned, or "".
        checks: of where its axes stood, as far as they were made.
        poses: the table of poses from which `axes` are; None where motor steps are given.
    """

    path: Path
    laser: StripeSettings
    frames: tuple[Path, ...] = ()
    video: Path | None = None
    axes: Positions = field(default_factory=dict)
    rules: Rules = field(default_factory=dict)
    backgrounds: tuple[Path, ...] = ()
    exposures_s: tuple[float, ...] | None = None
    name: str = ""
    checks: tuple[PlaceCheck, ...] = ()
    poses: Path | None = None

    @property
    def axis_names(self) -> tuple[str, ...]:
        """The axes in the order in which the file names them."""
        return tuple(self.rules or self.axes)

    @property
    def listed(self) -> int:
        """For how many frames positions are listed; 0 for a video with rules."""
        return max((len(positions) for positions in self.axes.values()), default=0)

    @property
    def positions(self) -> list[tuple[int, ...]]:
        """Positions of all axes at each frame, in the order of `axis_names`; none for a video with rules."""
        return list(zip(*self.axes.values(), strict=True))

    @property
    def moving(self) -> tuple[str, ...]:
        """The axes that move at some time."""
        by_rule = tuple(axis for axis, rule in self.rules.items() if rule.per_frame)
        return by_rule + tuple(axis for axis, n in self.axes.items() if not is_detail(axis) and len(set(n)) > 1)


def read_scan(path: str | os.PathLike[str]) -> Scan:
    """Read and check a scan, given its folder or its `scan.toml`.

    Frames in the same folder that are not listed are ignored, with a `PassedOverWarning`.

    Raises:
        InputError: whatever is wrong: file, key, value, and how to fix it. Whether all photographs have one size is not
            checked here but when they are decoded (or by `common_size`, which has to open each).
    """
    scan, by_list = _read(Path(path))
    # A glob says by itself what is left out; a list is what the hardware had made durable when it was cut off.
    if by_list:
        _say_unlisted(scan)
    return scan


def read_listed(path: str | os.PathLike[str]) -> Scan:
    """As `read_scan`, without a word on what lies beside the listed frames: for a scan that is being taken.

    Raises:
        InputError: as `read_scan`.
    """
    return _read(Path(path))[0]


def _read(path: Path) -> tuple[Scan, bool]:
    """The scan, and whether its frames are listed by name."""
    table = read_listing(path, SCAN_FILE, ("scan", "laser"))
    inner = table.table("scan", "[scan] ").only(
        "frames", "steps", "steps_per_frame", "axes", "poses", "background", "exposures_s", "name", "checks"
    )
    laser = StripeSettings()
    if "laser" in table:
        own = table.table("laser", "[laser] ")
        for key in _OF_THE_RIG:
            if key in own:
                raise own.error(
                    key,
                    "leave it out: a scan has it from the rig; [laser] of scan.toml has name, color and columns alone",
                )
        laser = read_stripe_settings(own.only("name", "color", "columns"))
    video = _video(inner)
    frames = () if video else files_of(inner, "frames")
    poses = None
    if POSES in inner:
        poses, axes = _axes_of_poses(inner, frames)
        rules = {}
    else:
        axes, rules = read_axes(inner, None if video else len(frames))
    n_frames = None if rules else len(next(iter(axes.values())))
    scan = Scan(
        path=table.path,
        laser=laser,
        frames=frames,
        video=video,
        axes=axes,
        rules=rules,
        backgrounds=_backgrounds(inner, n_frames),
        exposures_s=_exposures(inner, n_frames),
        name=inner.string("name") if "name" in inner else "",
        checks=read_checks(inner, n_frames),
        poses=poses,
    )
    return scan, isinstance(inner.values["frames"], list)


def write_scan(scan: Scan) -> None:
    """Write `scan.path`, whole or not at all, with its frames listed by name.

    Raises:
        InputError: the file cannot be written.
    """
    folder = scan.path.parent

    def names(paths: Sequence[Path]) -> list[str]:
        return [relative_name(path, folder) for path in paths]

    values: dict[str, Any] = {"name": scan.name} if scan.name else {}
    values["frames"] = relative_name(scan.video, folder) if scan.video else names(scan.frames)
    values |= {POSES: relative_name(scan.poses, folder)} if scan.poses else axes_values(scan.axes, scan.rules)
    if scan.backgrounds:
        values["background"] = names(scan.backgrounds)
    if scan.exposures_s is not None:
        values["exposures_s"] = list(scan.exposures_s)
    if scan.checks:
        values["checks"] = check_values(scan.checks)
    write_toml(scan.path, {"scan": values, "laser": stripe_values(scan.laser)})


def _video(table: Table) -> Path | None:
    name = table.values.get("frames")
    if not isinstance(name, str) or Path(name).suffix.lower() not in VIDEO_ENDINGS:
        return None
    video, *others = files_of(table, "frames")
    if others:
        raise table.error("frames", f"matches {1 + len(others)} videos: a scan is one, name it")
    return video


def _axes_of_poses(table: Table, frames: Sequence[Path]) -> tuple[Path, Positions]:
    """The table of the frames' poses, and what these are as positions."""
    # Whatever drives motors reads scans without JAX.
    from jaxscan.files.pose_table import named_table, read_pose_table
    from jaxscan.rig import positions_of

    for key in ("steps", "steps_per_frame", "axes"):
        if key in table:
            raise table.error(key, "poses is given too: a scan has either poses or motor steps, so keep one of them")
    poses = named_table(table, POSES, "frame")
    if not frames:
        raise table.error(POSES, "a table has poses by the names of photographs: name these in frames, not a video")
    return poses, {axis: tuple(n.tolist()) for axis, n in positions_of(read_pose_table(poses, frames)).items()}


def _backgrounds(table: Table, n_frames: int | None) -> tuple[Path, ...]:
    if "background" not in table:
        return ()
    paths = repeated_files_of(table, "background")
    if len(paths) not in (1, n_frames):
        raise table.error("background", f"{len(paths)} photographs for {_frames(n_frames)}: give one, or one for each")
    return paths


def _exposures(table: Table, n_frames: int | None) -> tuple[float, ...] | None:
    if "exposures_s" not in table:
        return None
    exposures = table.numbers("exposures_s")
    if len(exposures) != n_frames:
        raise table.error("exposures_s", f"{len(exposures)} exposure times for {_frames(n_frames)}: give one for each")
    if min(exposures, default=1.0) <= 0:
        raise table.error("exposures_s", "an exposure lasts longer than 0 seconds")
    return exposures


def _frames(count: int | None) -> str:
    return "a video of unknown length (list its positions)" if count is None else f"{count} frames"


def _say_unlisted(scan: Scan) -> None:
    """Warn of files that lie in the frames' folders, have a frame's ending, and are not part of the scan."""
    listed = {os.path.abspath(path) for path in (*scan.frames, *scan.backgrounds)}
    endings = {path.suffix for path in scan.frames}
    for folder in sorted({Path(os.path.abspath(path)).parent for path in scan.frames}):
        others = [path for path in folder.iterdir() if path.suffix in endings and str(path) not in listed]
        if others:
            others.sort(key=lambda path: natural_key(path.name))
            text = f"{scan.path}: ignored files in {folder} that are not listed: {name_some(others)}"
            warnings.warn(text, PassedOverWarning, 3)
