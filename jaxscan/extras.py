"""Packages that only some uses need: the extras of the installation, and what is said where one is missing."""

from importlib import import_module
from typing import Any, Final

from jaxscan.errors import InputError

# Of each extra: what needs it, what can be done without, and what is imported of it. The drivers of cameras (gphoto2,
# genicam) know no jaxscan, and say it themselves.
EXTRAS: Final = {
    "mesh-scenes": ("to render a mesh", "", ("embreex",)),
    "plots": ("to draw a picture", "", ("matplotlib",)),
    "poisson": ("a closed surface by screened Poisson", "", ("pymeshlab",)),
    "simplify": ("to make a mesh of fewer triangles", "", ("fast_simplification",)),
    "viewer": ("to look at a surface in the browser", "; or draw it with --png", ("viser",)),
    "rerun": ("to write a recording for Rerun", "", ("rerun",)),
    "features": (
        "to find the poses of scans by their shape",
        "; or say it with --turn, --steps or --poses (from Python 3.13 on the only way)",
        ("kiss_matcher",),
    ),
    "exchange": ("to read or write .e57 or .laz", "; or use .ply", ("laspy", "lazrs", "pye57")),
    "cluster": ("to hand scans to a scheduler", "", ("distributed",)),
    "lab": ("the lab server", "", ("argon2", "fastapi", "jinja2", "uvicorn")),
}


def extra(name: str) -> Any:
    """The first package of an extra, once all of them are known to be there.

    Raises:
        InputError: a package cannot be imported.
    """
    use, otherwise, packages = EXTRAS[name]
    found = []
    for package in packages:
        try:
            found.append(import_module(package))
        except ImportError as error:
            missing = isinstance(error, ModuleNotFoundError) and error.name == package
            raise InputError(
                f"{use} needs {package}, which {'is not installed' if missing else f'cannot be imported ({error})'}: "
                f'pip install "jaxscan[{name}]"{otherwise}'
            ) from error
    return found[0]
