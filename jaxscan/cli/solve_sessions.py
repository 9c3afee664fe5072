"""The solve of `jaxscan calibrate`: sessions in, the rig out, with progress bars."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

from jaxscan.cli.estimate_options import AS_THE_SESSION, Estimate
from jaxscan.cli.one_rig import Together, names, read_together
from jaxscan.detectors import DEFAULT, Detector
from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration, Observations
    from jaxscan.files.session import CameraSettings
    from jaxscan.rig import Camera, Rig


def solve_sessions(
    paths: Sequence[Path],
    camera: Path | None = None,
    name: str | None = None,
    hold: bool = False,
    detector: Detector = DEFAULT,
    estimate: Estimate = AS_THE_SESSION,
    needs_laser: bool = False,
) -> tuple["Calibration", "Calibration"]:
    """Calibrate with progress bars.

    Args:
        paths: the sessions, all of one rig; or a `.mat` with corners in place of one.
        camera: a file with a camera to start from.
        name: which camera of that file.
        hold: whether that camera is kept as it is.
        detector: how the stripe's centre is measured.
        estimate: lens, held parameters, board's shape and weights, as far as they are not the sessions'.
        needs_laser: whether the limit of speckle is asked for, which only a laser's stripe can show.

    Returns:
        The rig before a change and now, of a session in two parts; one and the same of others.
    """
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.calibration.known_scale import scale_note

    together = read_together(paths, estimate)
    together.check_laser(estimate, needs_laser)
    start = _read_start(camera, name, together) if camera else None
    _check_held(together.camera, start, hold)
    if (photographs := together.photographs()) is not None:
        estimate.check_named(photographs)
    observations = estimate.taken(_observed(together, detector))
    observations = replace(observations, notes=(*together.notes, *observations.notes))
    found = _found(observations, together, start, hold, estimate)
    scaled = [session for session in together.sessions if session.stage is not None]
    found = [
        replace(one, notes=(*one.notes, note)) if scaled and (note := scale_note(one, scaled)) else one for one in found
    ]
    return found[0], found[-1]


@dataclass(frozen=True)
class _Start:
    """What a file gives to begin with.

    Attributes:
        path: of the file.
        camera: its camera.
        rig: its rig, where more of it is held than of its camera.
    """

    path: Path
    camera: "Camera"
    rig: "Rig | None"


def _read_start(path: Path, name: str | None, together: Together) -> _Start:
    """Read the file of --camera, if its camera can have taken the photographs.

    Raises:
        InputError: it cannot, or the file is not usable.
    """
    from jaxscan.files.cameras import read_camera_file

    image_size, settings = together.contents[0].image_size, together.camera
    content = read_camera_file(path, name=name, image_size=image_size)
    camera = content.the_camera(path)
    centre = tuple((n - 1) / 2 for n in image_size)
    if settings.principal_point == "centre" and tuple(map(float, camera.principal)) != centre:
        raise InputError(
            f'{path}: its principal point is not the centre of the image, but the session holds it at the "centre": '
            "leave out principal_point, or the camera"
        )
    beyond = any(not held.startswith("camera.") for held in settings.hold)
    return _Start(path, camera, content.rig if beyond else None)


def _check_held(asked: "CameraSettings", start: _Start | None, hold_camera: bool) -> None:
    """Whether each parameter that is to be held has a value, before the long work.

    Raises:
        InputError: one has none.
    """
    from jaxscan.calibration.held import held_parameters, parameters_beyond_camera

    if hold_camera and asked.tilt and start is not None and not start.camera.tilt:
        raise InputError(
            f"{start.path}: its sensor is not tilted, and --hold-camera keeps it so; --tilt, or tilt under [camera], "
            "estimates a tilt: leave out one of them"
        )
    held_parameters(
        _holding(asked, start, hold_camera),
        _lens(asked, start),
        asked.principal_point,
        has_start=start is not None,
        tilted=_tilted(asked, start),
        beyond=parameters_beyond_camera(start.rig) if start and start.rig else (),
    )


def _lens(asked: "CameraSettings", start: _Start | None) -> str:
    return start.camera.lens.kind if start else asked.lens


def _tilted(asked: "CameraSettings", start: _Start | None) -> bool:
    return asked.tilt or bool(start and start.camera.tilt)


def _holding(asked: "CameraSettings", start: _Start | None, hold_camera: bool) -> tuple[str, ...]:
    """The parameters that are held, all of the camera among them where --hold-camera says so."""
    from jaxscan.rig.camera import camera_parameters

    camera = camera_parameters(_lens(asked, start), tilted=_tilted(asked, start)) if hold_camera else ()
    return tuple(dict.fromkeys((*camera, *asked.hold)))


def _observed(together: Together, detector: Detector) -> "Observations":
    """Corners and stripes of all photographs."""
    from jaxscan.calibration.observations import join
    from jaxscan.calibration.observe import observe, photograph_count
    from jaxscan.cli.progress import progress
    from jaxscan.files.session import Session

    with progress("finding boards and stripes", sum(map(photograph_count, together.sessions))) as advance:
        each = [
            observe(content, advance, detector) if isinstance(content, Session) else given
            for content, given in zip(together.contents, together.unseen, strict=True)
        ]
    return join(names(together.paths), each) if len(each) > 1 else each[0]


def _found(
    observations: "Observations", together: Together, start: _Start | None, hold_camera: bool, estimate: Estimate
) -> list["Calibration"]:
    """The rig; where the photographs are of two parts, that of each."""
    from jaxscan.calibration import calibrate, calibrate_by_evidence, calibrate_split
    from jaxscan.calibration.model import Model
    from jaxscan.cli.progress import progress

    asked = together.camera
    held = _holding(asked, start, hold_camera)
    if start is not None:
        zeros = estimate.zeros(start.path, start.camera)
        if zeros and not hold_camera:
            held = tuple({*held, *zeros})
            note = _kept_at_zero(start.path, zeros)
            observations = replace(observations, notes=(*observations.notes, note))
    model = Model(
        _lens(asked, start), asked.tilt, together.board_shape, together.sheets, together.motion, together.periods
    )
    begin = (start.rig or start.camera) if start else None
    rest = {"principal_point": asked.principal_point, "start": begin, "hold": held}
    with progress("solving", unit="step") as advance:
        if estimate.split is not None:
            rest |= {"plain": estimate.plain, "advance": advance.says}
            try:
                split = calibrate_split(observations, estimate.split, **model.asked(), **rest)
            except InputError as error:
                raise InputError(f"--split: {error}") from None
            return [split.before, split.after]
        if estimate.chooses:
            fixed = estimate.fixed() | ({"lens"} if start else set())
            return [calibrate_by_evidence(observations, model, fixed=fixed, advance=advance.says, **rest)]
        return [calibrate(observations, **model.asked(), **rest, plain=estimate.plain, advance=advance.says)]


def _kept_at_zero(path: Path, zeros: Sequence[str]) -> str:
    """The note on terms that a file has as 0."""
    are = "is" if len(zeros) == 1 else "are"
    return f"{', '.join(zeros)} {are} 0 in {path} and stayed 0: to estimate one, name it with --free"
