"""The options of `jaxscan mesh` for the texture of a .glb, and what they ask for."""

import argparse
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.errors import InputError

if TYPE_CHECKING:
    import numpy as np
    import trimesh

    from jaxscan.files.cloud import Cloud
    from jaxscan.reconstruction import RangeImage
    from jaxscan.surface.texture import Texture

# No graphics card of today refuses a texture of this side.
_MOST_PX: Final = 4096
_LEAST_PX: Final = 64
_LARGEST_PX: Final = 16384


def add_texture_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare where the texture's colours come from, and its size."""
    parser.add_argument(
        "--photographs",
        type=Path,
        metavar="SCAN",
        help="the scan of a range image (a folder with scan.toml): the texture of .glb shows what its photographs show "
        "between the points too; needs --rig (default: the colours of the points)",
    )
    parser.add_argument(
        "--texture-px",
        type=int,
        default=_MOST_PX,
        metavar="N",
        help=f"longest side of the texture of a coloured .glb (default: {_MOST_PX}; it is smaller where the points "
        "are no denser); 0 for colours of the vertices instead",
    )


def check_texture(args: argparse.Namespace) -> None:
    """Refuse what does not go together, before any work.

    Raises:
        InputError: it does not.
    """
    if args.texture_px and not _LEAST_PX <= args.texture_px <= _LARGEST_PX:
        raise InputError(f"--texture-px {args.texture_px}: give {_LEAST_PX} to {_LARGEST_PX}, or 0 for no texture")
    if args.photographs is None:
        return
    if not (args.texture_px and any(path.suffix.lower() == ".glb" for path in args.output)):
        raise InputError("--photographs: only .glb has a texture: write -o NAME.glb, or leave --photographs out")
    if args.points.suffix.lower() != ".npz":
        raise InputError(f"{args.points}: --photographs needs the frames of a range image: give the .npz")
    if args.rig is None:
        raise InputError("--photographs: needs --rig too: the rig that the scan was reconstructed with")


def texture_asked(
    args: argparse.Namespace,
    mesh: "trimesh.Trimesh",
    own: "np.ndarray | None",
    painted: "Cloud",
    image: "RangeImage | None",
    result: dict[str, Any],
) -> "Texture | None":
    """The texture of a mesh; None where no .glb is written, none is asked for, or no colour is known.

    Args:
        args: the command's.
        mesh: as it is written.
        own: colours of its vertices where these are points of the scan.
        painted: the scan's points.
        image: as they were read; None for a cloud.
        result: the command's; what the texture is like is added, None where the surface has none.
    """
    scan: Path | None = args.photographs
    glb = any(path.suffix.lower() == ".glb" for path in args.output)
    if not (glb and args.texture_px and (scan is not None or (painted.colours is not None and painted.colours.any()))):
        return None
    from jaxscan.surface.texture import Photographs, make_texture

    source = None
    if scan is not None and image is not None:
        from jaxscan.cli.compiled import keep_compiled

        keep_compiled()
        from jaxscan.files.rig_file import read_rig
        from jaxscan.files.scan import read_scan

        source = Photographs(read_rig(args.rig).rig, read_scan(scan), image)
    made = make_texture(mesh, painted, own, source, args.texture_px)
    if made is None:
        result["texture"] = None
        return None
    result["texture"] = {
        "size": list(made.atlas.size),
        "texel_mm": made.atlas.texel_mm,
        "charts": made.atlas.charts,
        "texels": made.texels,
        "photographed": made.photographed,
        "interpolated": made.interpolated,
    }
    return made


def texture_in_words(texture: dict[str, Any] | None) -> str:
    """Size and source of a texture, a line; None where the surface has none."""
    if texture is None:
        return (
            "  texture    none: the surface is too rough to be laid on a picture, so .glb has colours of the vertices: "
            "clean it, reduce it with --simplify, or raise --texture-px"
        )
    columns, rows = texture["size"]
    n = texture["texels"]
    parts = [
        f"{100 * texture[key] / n:.1f} % {words}"
        for key, words in (("photographed", "from photographs"), ("interpolated", "between points"))
        if texture[key]
    ]
    grey = n - texture["photographed"] - texture["interpolated"]
    parts += [f"{100 * grey / n:.1f} % grey, without a colour"] if grey else []
    return f"  texture    {columns} x {rows} of {texture['texel_mm']:.3g} mm in .glb: {', '.join(parts)}"
