"""`jaxscan view`: a cloud or a mesh in the browser, with the scanner around it; or as a still picture."""

import argparse
from pathlib import Path
from typing import Any, Final

from jaxscan.cli.options import check_outputs
from jaxscan.cli.progress import resting, step
from jaxscan.errors import InputError
from jaxscan.extras import extra

HELP: Final = "look at a range image, a cloud or a mesh, in the browser or as a picture"
EXAMPLE: Final = "jaxscan view cup.npz --rig rig.json"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the command's arguments."""
    parser.add_argument("file", type=Path, metavar="FILE", help="a range image (.npz), a cloud or a mesh")
    parser.add_argument("--rig", type=Path, help="show its cameras, light plane and the stage's travel")
    parser.add_argument(
        "--colour",
        choices=("height", "sigma", "strength", "albedo", "photograph"),
        help="of the points; photograph: their own (default: height; of a mesh that has colours, these)",
    )
    parser.add_argument("--png", type=Path, metavar="OUT", help="draw a picture in place of opening the browser")
    parser.add_argument("--port", type=int, default=8080, help="of this machine (default: 8080, or the next free one)")
    parser.add_argument("--no-browser", action="store_true", help="serve, and open no window")


def run(args: argparse.Namespace) -> dict[str, Any] | None:
    """Read and show."""
    if not 0 < args.port < 65536:
        raise InputError(f"--port {args.port}: give a number from 1 to 65535")
    extra("plots" if args.png else "viewer")
    check_outputs([], args.png, [args.file])
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


def describe(result: dict[str, Any]) -> str:
    """The result in words."""
    what = f"{result['points']} points" + (f", {result['triangles']} triangles" if result["triangles"] else "")
    return f"{result['path']}: {what}, coloured by {result['colour']}: {result['picture']}"
