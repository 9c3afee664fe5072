"""What is detected in one photograph, drawn over it. Imported by the command when it runs, so freely slow."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float

from jaxscan.atomic import check_writable
from jaxscan.cli.options import check_outputs
from jaxscan.detectors import DEFAULT, DEFAULT_CHOICE, Choice, Detector
from jaxscan.errors import InputError, error_context
from jaxscan.files.scan import Scan, read_scan
from jaxscan.files.session import Session, read_session
from jaxscan.images import Stripe, StripeSettings, detect_stripe, find_board, read_image, read_video, write_image
from jaxscan.images.decode import Image, check_image_ending
from jaxscan.images.overlay import draw_board, draw_stripe
from jaxscan.reconstruction import read_range_image
from jaxscan.reconstruction.light_watch import LightWatch


def draw_frame(
    path: Path, index: int, out: Path, detector: Detector = DEFAULT, choice: Choice = DEFAULT_CHOICE
) -> dict[str, Any]:
    """Draw the stripe over frame `index` of a scan.

    Raises:
        InputError: there is no such frame, or the picture cannot be written.
    """
    scan = read_scan(path)
    _spare(out, [*scan.frames, *scan.backgrounds])
    image, background = _frame(scan, index)
    stripe = _stripe(scan.path, image, scan.laser, background, detector, choice)
    position, watch = stripe.position.ravel(), LightWatch()
    watch.see(stripe)
    write_image(out, draw_stripe(image, position, scan.laser.columns))
    notes = watch.notes(scan.exposures_s is not None, background is not None, scan.laser.color == "grey")
    return {"path": str(out), **_found(position, scan.laser), "notes": notes}


def draw_view(
    path: Path, index: int, out: Path, detector: Detector = DEFAULT, choice: Choice = DEFAULT_CHOICE
) -> dict[str, Any]:
    """Draw the corners, and the stripe of each laser, over view `index` of a session.

    Raises:
        InputError: there is no such view, or the picture cannot be written.
    """
    session = read_session(path)
    _check(path, index, len(session.views.boards), "views")
    _spare(out, session.photographs())
    photograph = read_image(session.views.boards[index])
    found = find_board(session.board, photograph)
    corners = 0 if found is None else int(np.isfinite(found.corners).all(axis=1).sum())
    picture = photograph if found is None else draw_board(photograph, found.corners, session.board.counts)
    lasers = []
    for laser in session.lasers:
        lit = _lit(session, laser, index, photograph)
        if lit is not None:
            position = _stripe(session.path, lit, laser, None, detector, choice).position.ravel()
            picture = draw_stripe(picture, position, laser.columns)
            lasers.append({"name": laser.name, **_found(position, laser)})
    write_image(out, picture)
    return {"path": str(out), "corners": corners, "of_corners": len(session.board.points()), "lasers": lasers}


def draw_range_image(path: Path, out: Path) -> dict[str, Any]:
    """Draw a range image in its views, with what cleaning would take of it.

    Raises:
        InputError: there is no surface, or the picture cannot be written.
    """
    from jaxscan.surface.clean import clean
    from jaxscan.view.surface_plots import draw_range

    check_outputs([], out, [path])
    image = read_range_image(path)
    with error_context(path):
        cleaned = clean(image)
        draw_range(out, image, removed=cleaned.removed)
    return {"path": str(out), "removed": cleaned.counts()}


def _frame(scan: Scan, index: int) -> tuple[Image, Image | None]:
    """A frame and what is to be subtracted from it."""
    if scan.video:
        image = next((frame for i, frame in enumerate(read_video(scan.video)) if i == index), None)
        if image is None:
            raise InputError(f"{scan.video}: has no frame {index}: they count from 0")
    else:
        _check(scan.path, index, len(scan.frames), "frames")
        image = read_image(scan.frames[index])
    if not scan.backgrounds:
        return image, None
    return image, read_image(scan.backgrounds[index if len(scan.backgrounds) > 1 else 0])


def _lit(session: Session, laser: StripeSettings, index: int, photograph: Image) -> Image | None:
    """The photograph of a view in which a laser's stripe is looked for; None where there is none."""
    lit = session.views.lit(laser.name, index)
    # Of a light that moves, where it stands in the middle.
    path = lit[len(lit) // 2][1] if lit else None
    return None if path is None else photograph if path == session.views.boards[index] else read_image(path)


def _stripe(
    path: Path, image: Image, laser: StripeSettings, background: Image | None, detector: Detector, choice: Choice
) -> Stripe:
    with error_context(path):
        return detect_stripe(image, laser, background, detector=detector, choice=choice)


def _found(position: Float[np.ndarray, "lines"], laser: StripeSettings) -> dict[str, Any]:
    lines = "columns" if laser.columns else "rows"
    return {"stripe_points": int(np.isfinite(position).sum()), f"of_{lines}": len(position)}


def _spare(out: Path, photographs: Sequence[Path]) -> None:
    """Refuse to draw over the place of a photograph, and whatever else could not be written, before any work."""
    check_writable(out)
    check_image_ending(out)
    if out.exists() and any(out.samefile(photograph) for photograph in photographs):
        raise InputError(f"{out}: is a photograph of this session or scan: name another file for the picture")


def _check(path: Path, index: int, count: int, what: str) -> None:
    if not 0 <= index < count:
        raise InputError(f"{path}: --frame {index}: it has {count} {what}, counted from 0 to {count - 1}")
