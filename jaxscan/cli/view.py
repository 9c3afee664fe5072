"""`jaxscan view`: a cloud or a mesh in the browser, with the scanner around it; as a picture; as a recording."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.cli.options import check_outputs
from jaxscan.cli.progress import resting, step
from jaxscan.errors import InputError
from jaxscan.extras import extra

if TYPE_CHECKING:
    from jaxscan.rig import Rig
    from jaxscan.view.view_data import ViewData

HELP: Final = "look at a range image, a cloud or a mesh, in the browser, as a picture, or in Rerun"
EXAMPLE: Final = "jaxscan view cup.npz --rig rig.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a range image (.npz), a cloud or a mesh")
    parser.add_argument("--rig", type=Path, help="show its cameras, light plane and the stage's travel")
    parser.add_argument(
        "--colour",
        choices=("height", "z", "sigma", "strength", "albedo", "photograph"),
        help="of the points; photograph: their own (default: the height over the floor, or z where no floor is known; "
        "of a mesh that has colours, these)",
    )
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw a picture in place of opening the browser")
    parser.add_argument(
        "--rerun", type=Path, metavar="OUT", help="write a recording (.rrd) for Rerun in place of that (extra rerun)"
    )
    parser.add_argument(
        "--photographs",
        type=Path,
        metavar="SCAN",
        help="the scan of a range image (a folder with scan.toml): the recording has its photographs; needs --rig",
    )
    parser.add_argument("--port", type=int, default=8080, help="of this machine (default: 8080, or the next free one)")
    parser.add_argument("--no-browser", action="store_true", help="serve, and open no window")


def run(args: argparse.Namespace) -> dict[str, Any] | None:
    """Read and show."""
    if not 0 < args.port < 65536:
        raise InputError(f"--port {args.port}: give a number from 1 to 65535")
    _check_recording(args)
    extra("plots" if args.png else "rerun" if args.rerun else "viewer")
    check_outputs([args.rerun] if args.rerun else [], args.png, [args.file, *([args.rig] if args.rig else [])])
    from jaxscan.errors import error_context
    from jaxscan.view.view_data import view_data

    rig = None
    step(f"reading {args.file}")
    if args.rig:
        from jaxscan.files.rig_file import read_rig

        rig = read_rig(args.rig).rig
    shown = view_data(args.file, rig)
    with error_context(args.file):
        colour = shown.colour(args.colour)
    result = {
        "kind": "view",
        "path": str(args.file),
        "points": len(shown.points),
        "triangles": None if shown.triangles is None else len(shown.triangles),
        "colours": list(shown.looks),
        "colour": colour,
    }
    if args.png:
        from jaxscan.view.surface_plots import draw_view_data

        step(f"drawing {args.png}")
        draw_view_data(args.png, shown, colour, args.file.name)
        return result | {"picture": str(args.png)}
    if args.rerun:
        recorded = _record(args, shown, colour, rig)
        return result | {"recording": str(args.rerun), "cameras": recorded[0], "photographs": recorded[1]}
    from jaxscan.cli.compiled import keep_compiled
    from jaxscan.cli.measure import read_surface
    from jaxscan.view.viewer import HOST, serve

    keep_compiled()
    rig_of_scan = args.rig if args.file.suffix.lower() == ".npz" else None
    server = serve(shown, args.port, lambda: read_surface(args.file, rig_of_scan)[0], colour, args.file.stem)
    address = f"http://{HOST}:{server.get_port()}"
    with resting():
        print(f"{args.file} at {address}, until Ctrl-C", flush=True)
        if not args.no_browser:
            import webbrowser

            webbrowser.open(address)
        try:
            server.sleep_forever()
        finally:
            server.stop()
    return None


def _check_recording(args: argparse.Namespace) -> None:
    """Refuse what does not go together, before any work."""
    if args.rerun is None:
        if args.photographs is not None:
            raise InputError("--photographs: only a recording has them: add --rerun OUT.rrd, or leave it out")
        return
    if args.png is not None:
        raise InputError("--rerun and --png: give one of them at a time")
    if args.rerun.suffix.lower() != ".rrd":
        raise InputError(f"--rerun {args.rerun}: a recording of Rerun is an .rrd: end its name with .rrd")
    if args.photographs is not None and args.file.suffix.lower() != ".npz":
        raise InputError(f"{args.file}: --photographs needs the frames of a range image: give the .npz")
    if args.photographs is not None and args.rig is None:
        raise InputError("--photographs: needs --rig too: the rig that the scan was reconstructed with")


def _record(args: argparse.Namespace, shown: "ViewData", colour: str, rig: "Rig | None") -> tuple[int, int]:
    """Write the recording; returned are how many camera poses and how many photographs it has."""
    from jaxscan.view.recording import photographs_of, write_recording

    photographs = ()
    if args.photographs is not None:
        from jaxscan.cli.compiled import keep_compiled
        from jaxscan.files.scan import read_scan
        from jaxscan.reconstruction import read_range_image

        keep_compiled()
        photographs = photographs_of(read_scan(args.photographs), len(read_range_image(args.file).valid))
    step(f"writing {args.rerun}")
    camera = None if rig is None else rig.camera
    recorded = write_recording(args.rerun, shown, colour, camera, photographs)
    return 0 if shown.setup is None else len(shown.setup.frames), recorded


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    what = f"{result['points']} points" + (f", {result['triangles']} triangles" if result["triangles"] else "")
    where = result.get("picture")
    if where is None:
        where = result["recording"]
        for name in ("cameras", "photographs"):
            what += f", {result[name]} {name}" if result[name] else ""
    return f"{result['path']}: {what}, coloured by {result['colour']}: {where}"
