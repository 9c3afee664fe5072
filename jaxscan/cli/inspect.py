"""`jaxscan inspect`: a session, scan, rig, camera, cloud, range image or mesh in words, and in a picture."""

import argparse
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.camera_options import add_camera_arguments
from jaxscan.cli.detector_options import add_choice_argument, add_detector_argument
from jaxscan.cli.format_summary import format_summary
from jaxscan.cli.options import add_optics_arguments, optics_asked
from jaxscan.cli.progress import step
from jaxscan.errors import InputError
from jaxscan.extras import extra
from jaxscan.files.formats import ENDINGS
from jaxscan.missing import no_such_file

HELP: Final = "describe in words what a session, scan, rig, camera, cloud, range image or mesh contains"
EXAMPLE: Final = "jaxscan inspect scans/cup --frame 12 --png cup-12.png"

_DEFAULT: Final = "-"
_FOLDERS: Final = ("session", "scan", "profiles")


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument(
        "path",
        type=Path,
        help="a folder with session.toml, scan.toml or profiles.toml, one .toml, .ply, .npz, .stl, .obj, .glb, or a "
        "camera: "
        f"{', '.join(ENDINGS)}",
    )
    parser.add_argument("--frame", type=int, metavar="N", help="which photograph to draw, counted from 0 (default: 0)")
    parser.add_argument(
        "--png",
        nargs="?",
        type=Path,
        const=Path(_DEFAULT),
        metavar="OUT",
        help="draw the stripe over the scan's photograph N, or corners and stripe over the session's view N, "
        "or a range image in its views (default: named after what is drawn, here)",
    )
    add_detector_argument(parser)
    add_choice_argument(parser)
    add_camera_arguments(parser)
    optics = add_optics_arguments(
        parser, "how near a range image comes to what speckle alone leaves; all four go together"
    )
    optics.add_argument("--rig", type=Path, metavar="RIG", help="the rig that it was reconstructed with (.json)")


def run(args: argparse.Namespace) -> dict[str, Any]:
    """Read what the path names, whatever it is, and draw where that was asked for."""
    kind, path = _kind(args.path)
    if args.frame is not None and args.png is None:
        raise InputError("--frame chooses the photograph to draw: add --png, and a name for the picture if you like")
    if args.png is not None and kind not in ("session", "scan", "range image"):
        raise InputError(f"{path}: --png draws what is detected in a photograph, and a {kind} has none: leave it out")
    if args.frame is not None and kind == "range image":
        raise InputError(f"{path}: --frame chooses a photograph, and a range image is drawn whole: leave it out")
    if kind != "camera" and (args.name or args.image_size):
        raise InputError(f"{path}: --name and --image-size are for cameras of other programs, not for a {kind}")
    if args.png is not None and kind == "range image":
        extra("plots")
    from jaxscan.cli import summary

    read = {
        "session": summary.session_summary,
        "scan": summary.scan_summary,
        "profiles": summary.profiles_summary,
        "rig": summary.rig_summary,
        "PLY": summary.ply_summary,
        "mesh": summary.mesh_summary,
        "range image": summary.range_summary,
    }
    optics = optics_asked(args)
    if (optics is None) != (args.rig is None) or (optics is not None and kind != "range image"):
        raise InputError(
            f"{path}: --rig, --f-number, --wavelength-nm and --pixel-um go together, and with a range image (.npz): "
            "give all four, or none"
        )
    step(f"reading {path}")
    result = summary.camera_summary(path, args.name, args.image_size) if kind == "camera" else read[kind](path)
    if optics is not None:
        result["speckle_limit"] = summary.speckle_limit_summary(path, args.rig, optics)
    if args.png is not None:
        from jaxscan.cli import picture
        from jaxscan.cli.compiled import keep_compiled

        keep_compiled()
        frame = args.frame or 0
        own = f"{path.stem}-views" if kind == "range image" else f"{path.absolute().parent.name}-{frame}"
        out = args.png if args.png != Path(_DEFAULT) else Path(f"{own}.png")
        step(f"drawing {out}")
        if kind == "range image":
            result["picture"] = picture.draw_range_image(path, out)
        else:
            draw = picture.draw_view if kind == "session" else picture.draw_frame
            result["picture"] = draw(path, frame, out, args.detector, args.stripe)
    return result


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    return format_summary(result)


def _kind(path: Path) -> tuple[str, Path]:
    """What a path names, and the file to read."""
    if path.is_dir():
        return _kind_of_folder(path)
    if not path.exists():
        raise no_such_file(Path(path), "file or folder")
    ending = path.suffix.lower()
    if ending == ".toml":
        from jaxscan.files.text import read_toml

        table = read_toml(path)
        return next((kind for kind in ("scan", "profiles") if kind in table), "session"), path
    kinds = dict.fromkeys(ENDINGS, "camera") | {".json": "rig", ".ply": "PLY", ".npz": "range image"}
    kinds |= dict.fromkeys((".stl", ".obj", ".glb"), "mesh")
    if ending not in kinds:
        raise InputError(
            f'{path}: there is no format with the ending "{ending}": '
            "name a session or scan (folder or .toml), a rig (.json), "
            "points or a mesh (.ply, .stl, .obj, .glb), a range image (.npz), "
            f"or a camera of another program ({', '.join(ENDINGS)})"
        )
    return kinds[ending], path


def _kind_of_folder(path: Path) -> tuple[str, Path]:
    there = [kind for kind in _FOLDERS if (path / f"{kind}.toml").is_file()]
    if not there:
        from jaxscan.files.settings import refuse_hidden_ending

        for kind in _FOLDERS:
            refuse_hidden_ending(path, f"{kind}.toml")
        raise InputError(
            f"{path}: has neither session.toml nor scan.toml nor profiles.toml: name the folder that has, or a file"
        )
    if len(there) > 1:
        raise InputError(f"{path}: has both {there[0]}.toml and {there[1]}.toml: name one of the two files")
    return there[0], path / f"{there[0]}.toml"
