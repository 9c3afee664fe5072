"""`reconstruct`: from the photographs of a scan to its range image, in memory or in files."""

import os
from collections.abc import Callable, Iterable, Sequence
from contextlib import ExitStack
from dataclasses import dataclass, replace

import numpy as np

from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings
from jaxscan.images.decode import Image
from jaxscan.images.stripes.batch import FRAMES_AT_ONCE
from jaxscan.reconstruction.range_image import RangeImage, writing_points
from jaxscan.reconstruction.stream import Scanner
from jaxscan.rig import Positions, Rig

# The level of a pixel that is full.
_FULL = 255


def reconstruct(
    rig: RigFile | Rig,
    scan: Scan | Iterable[tuple[Image, Positions | int]],
    advance: Callable[[int], object] = lambda by: None,
    detector: Detector = DEFAULT,
    choice: Choice = DEFAULT_CHOICE,
    spacetime: bool = False,
    depths_mm: tuple[float, float] | None = None,
    *,
    laser: StripeSettings | None = None,
    background: Image | None = None,
) -> RangeImage:
    """Find the stripe in every frame and triangulate it.

    Args:
        rig: the rig, as `read_rig` gives it; with its covariance the points carry their σ.
        scan: as `read_scan` gives it; or photographs in memory, (rows, columns) or (rows, columns, 3) with red, green
            and blue, 8 or 16 bits, each with the positions of the axes by their names, motor steps, or with the step
            count of the stage.
        advance: called with the number of photographs read, batch after batch.
        detector: how the stripe's centre is measured.
        choice: which stripe is taken where a line has several.
        spacetime: measure the time at which the light's centre passes each point; needs a scan in small, equal steps.
        depths_mm: nearest and farthest depth at which there can be a stripe, as `Scanner` has it.
        laser: of photographs in memory: which laser, and how its stripe is searched; by default one red laser, and a
            point for each column.
        background: of photographs in memory: the scene with the laser off.

    Returns:
        The points, (frames, columns) of them or (frames, rows), object frame, mm.

    Raises:
        InputError: the scan does not fit the rig, a photograph cannot be read, or there is no stripe in any frame.
    """
    scanner = Scanner(rig, detector, choice, spacetime, depths_mm)
    if not isinstance(scan, Scan):
        image = _of_memory(scanner, scan, advance, spacetime, laser, background)
    elif laser is not None or background is not None:
        raise InputError("laser= and background= are for photographs in memory: scan.toml names those of a scan")
    else:
        image = RangeImage.joined(list(scanner.scan(scan, advance)))
    return replace(image, notes=tuple(scanner.notes))


def _of_memory(
    scanner: Scanner,
    frames: Iterable[tuple[Image, Positions | int]],
    advance: Callable[[int], object],
    spacetime: bool,
    laser: StripeSettings | None,
    background: Image | None,
) -> RangeImage:
    """The points of photographs in memory."""
    if spacetime:
        raise InputError("spacetime=True takes a scan that read_scan has read: write the photographs into a folder")
    parts = []
    for part in scanner.frames(frames, laser, background, FRAMES_AT_ONCE, whole=True):
        parts.append(part)
        advance(len(part.valid))
    if not parts:
        raise InputError("there are no photographs: give at least one, with the positions of its axes")
    image = RangeImage.joined(parts)
    if not image.valid.any():
        why = "".join(f"; {note}" for note in scanner.notes)
        raise InputError(f"no point was found in any of {len(image.valid)} photographs{why}")
    return image


@dataclass(frozen=True)
class Written:
    """What was written of a scan.

    Attributes:
        frames: how many there were.
        empty: how many of them have no point.
        points: how many points.
        coloured: how many of them have a colour; None where the scan has no colours.
        full: in how many of these a channel of the photograph is full.
        reflecting: how many points have an albedo; None where it was not asked for.
    """

    frames: int
    empty: int
    points: int
    coloured: int | None = None
    full: int = 0
    reflecting: int | None = None


def write_stream(
    outputs: Sequence[str | os.PathLike[str]],
    parts: Iterable[RangeImage],
    notes: Callable[[], Sequence[str]] = tuple,
) -> Written:
    """Write a scan of any length while it is read, with the memory of a short one.

    Args:
        outputs: .ply or .npz files; at the end each is complete, or does not exist.
        parts: the scan, some frames at a time, as `Scanner.scan` gives it.
        notes: asked once the last part has come; what it returns is in each .npz, as `Scanner.notes` has it.

    Raises:
        InputError: what reading the scan raises, or a file cannot be written.
    """
    frames = empty = points = full = 0
    coloured = reflecting = None
    with ExitStack() as files:
        sinks = [files.enter_context(writing_points(path, notes)) for path in outputs]
        for image in parts:
            for add in sinks:
                add(image)
            frames += len(image.steps)
            empty += int(np.sum(~image.valid.any(axis=1)))
            points += int(image.valid.sum())
            if image.colours is not None:
                colours = image.colours[image.valid]
                coloured = (coloured or 0) + int(colours.any(axis=-1).sum())
                full += int((colours == _FULL).any(axis=-1).sum())
            if image.albedo is not None:
                reflecting = (reflecting or 0) + int(np.isfinite(image.albedo[image.valid]).sum())
    return Written(frames, empty, points, coloured, full, reflecting)
