"""`jaxscan calibrate`: photographs of a board in, a rig with its covariance out."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.errors import InputError

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration
    from jaxscan.files.session import CameraSettings
    from jaxscan.rig import Camera

HELP: Final = "find camera, lens, light plane and stage from photographs of a board, all together"
EXAMPLE: Final = "jaxscan calibrate session -o rig.json\n  jaxscan calibrate session --camera camera.yml --hold-camera"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "session",
        type=Path,
        metavar="SESSION",
        help="a folder with session.toml, that file, or the corners that Bouguet's toolbox saved: calib_data.mat",
    )
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        default=Path("rig.json"),
        metavar="RIG",
        help="the rig to write (default: rig.json)",
    )
    parser.add_argument(
        "--camera",
        type=Path,
        metavar="FILE",
        help="start from the camera of this file, and keep its lens: a rig.json, or what `jaxscan convert` reads",
    )
    parser.add_argument("--hold-camera", action="store_true", help="keep the camera of --camera as it is")
    parser.add_argument("--camera-name", metavar="CAM", help="which camera of a camchain of several: cam0, cam1, …")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read the session, find corners and stripes, solve, and write the rig."""
    from jaxscan.atomic import check_writable

    if args.output.suffix.lower() != ".json":
        raise InputError(f"{args.output}: a rig is a JSON file: end its name with .json")
    check_writable(args.output)
    if args.camera is None and (args.hold_camera or args.camera_name):
        raise InputError("--hold-camera and --camera-name speak of the camera of a file: name it with --camera FILE")
    calibration = calibrate_session(args.session, args.output, args.camera, args.camera_name, args.hold_camera)
    from jaxscan.cli.facts import rig_facts

    return {
        **rig_facts(args.output),
        "left_out": list(calibration.left_out),
        "notes": list(calibration.notes),
    }


def calibrate_session(
    path: Path, output: Path, camera: Path | None = None, name: str | None = None, hold: bool = False
) -> "Calibration":
    """Calibrate with progress bars, and write the rig.

    Args:
        path: the session, or a `.mat` with corners.
        output: the rig to write.
        camera: a file with a camera to start from.
        name: which camera of that file.
        hold: whether that camera is kept as it is.
    """
    from jaxscan.cli.compiled import keep_compiled

    keep_compiled()
    from jaxscan.calibration import calibrate
    from jaxscan.calibration.observe import observe, photograph_count
    from jaxscan.cli.progress import progress
    from jaxscan.files.rig_file import write_rig
    from jaxscan.files.session import CameraSettings, read_session
    from jaxscan.rig import Rig
    from jaxscan.rig.rig import parameter_names

    if path.suffix.lower() == ".mat":
        from jaxscan.calibration.board_views import observations_from
        from jaxscan.files.cameras import read_camera_file

        content, settings = read_camera_file(path), CameraSettings()
        start = _start(camera, name, settings, content.image_size) if camera else None
        observations = observations_from(content, path)
    else:
        session = read_session(path)
        settings = session.camera
        start = _start(camera, name, settings, session.image_size) if camera else None
        with progress("finding boards and stripes", photograph_count(session)) as advance:
            observations = observe(session, advance)
    held = parameter_names(Rig(start)) if start and hold else ()
    with progress("solving", 1, "rig") as advance:
        calibration = calibrate(
            observations,
            lens=settings.lens,
            principal_point=settings.principal_point,
            start=start,
            hold=held,
        )
        advance(1)
    write_rig(output, calibration.rig_file())
    return calibration


def _start(path: Path, name: str | None, settings: "CameraSettings", image_size: tuple[int, int]) -> "Camera":
    """The camera of a file, if it can have taken the photographs."""
    from jaxscan.files.cameras import read_camera

    camera = read_camera(path, name=name, image_size=image_size)
    centre = tuple((n - 1) / 2 for n in image_size)
    if settings.principal_point == "centre" and tuple(map(float, camera.principal)) != centre:
        raise InputError(
            f'{path}: its principal point is not the centre of the image, but the session holds it at the "centre": '
            "leave out principal_point, or the camera"
        )
    return camera


def describe(result: dict[str, Any]) -> str:
    """The rig in words, then what was left out."""
    from jaxscan.cli.words import in_words

    lines = [in_words(result)]
    for title, key in (("left out", "left_out"), ("note", "notes")):
        lines += [f"{title}: {line}" for line in result[key]]
    return "\n".join(lines)
