"""Without an extra every use of it says how to install it, before any work; and no use is forgotten."""

import ast
import sys
import tomllib
from pathlib import Path

import pytest

from hardware.cameras.genicam import GenICamCamera
from hardware.cameras.gphoto import GPhotoCamera
from hardware.cli import main as scanner
from hardware.errors import CameraError
from jaxscan.cli import main as jaxscan
from jaxscan.errors import InputError
from jaxscan.extras import EXTRAS
from jaxscan.simulation.mesh import Mesh
from jaxscan.surface.scattered import poisson_surface
from jaxscan.view import surface_plots

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
# What is imported of each package whose name is another, and what comes with one.
IMPORTED = {
    "opencv-python-headless": "cv2",
    "pyserial": "serial",
    "pyyaml": "yaml",
    "tomli-w": "tomli_w",
    "kiss-matcher": "kiss_matcher",
    "fast-simplification": "fast_simplification",
    "argon2-cffi": "argon2",
    "rerun-sdk": "rerun",
}
COMES_WITH = {
    "starlette": "fastapi",
    "h11": "uvicorn",
    "pydantic": "fastapi",
    "markupsafe": "jinja2",
    "dask": "distributed",
    "jaxlib": "jax",
    "mpl_toolkits": "matplotlib",
    "PIL": "viser",
}
PACKAGES = {
    name: {
        IMPORTED.get(package, package)
        for line in lines
        # laspy[lazrs] is two packages.
        for package in line.split(">=")[0].removesuffix("]").split("[")
    }
    for name, lines in PROJECT["optional-dependencies"].items()
    if name not in ("docs", "dev")
}
# Where packages of an extra are imported outside of `jaxscan.extras`: behind `extra`, or said by the driver itself.
BEHIND = {
    "jaxscan/reconstruction/batch.py": "cluster",
    "jaxscan/simulation/mesh.py": "mesh-scenes",
    "jaxscan/view/calibration_plots.py": "plots",
    "jaxscan/view/matplotlib_setup.py": "plots",
    "jaxscan/view/surface_plots.py": "plots",
    "jaxscan/view/viewer.py": "viewer",
    "jaxscan/files/exchange.py": "exchange",
    "hardware/cameras/genicam.py": "genicam",
    "hardware/cameras/gphoto.py": "gphoto2",
    "hardware/lab": "lab",
}


@pytest.fixture
def without(monkeypatch):
    """Make the packages of an extra fail to import."""

    def block(extra: str) -> None:
        for package in PACKAGES[extra]:
            loaded = [name for name in sys.modules if name == package or name.startswith(f"{package}.")]
            for name in (package, *loaded):
                monkeypatch.setitem(sys.modules, name, None)

    return block


def imports(path: Path) -> set[tuple[str, bool]]:
    """The packages that a file imports, and whether it does so as it is imported itself."""
    found = set()

    def walk(node: ast.AST, first: bool) -> None:
        names = []
        if isinstance(node, ast.Import):
            names = [alias.name for alias in node.names]
        elif isinstance(node, ast.ImportFrom) and node.module and not node.level:
            names = [node.module]
        elif isinstance(node, ast.Call) and getattr(node.func, "id", getattr(node.func, "attr", "")) == "import_module":
            names = [arg.value for arg in node.args[:1] if isinstance(arg, ast.Constant)]
        found.update((str(name).split(".")[0], first) for name in names if not str(name).startswith("."))
        inside = isinstance(node, ast.FunctionDef | ast.AsyncFunctionDef)
        typing = isinstance(node, ast.If) and getattr(node.test, "id", "") == "TYPE_CHECKING"
        for child in ast.iter_child_nodes(node):
            walk(child, first and not inside and not typing)

    walk(ast.parse(path.read_text()), True)
    return found


def test_every_import_is_a_dependency_or_behind_its_extra():
    needed = {IMPORTED.get(name, name) for name in (line.split(">=")[0] for line in PROJECT["dependencies"])}
    of_extra = {package: extra for extra, packages in PACKAGES.items() for package in packages}
    found: dict[str, str] = {}
    for path in (path for folder in ("jaxscan", "hardware") for path in (ROOT / folder).rglob("*.py")):
        where = path.relative_to(ROOT).as_posix()
        for imported, at_once in imports(path):
            name = COMES_WITH.get(imported, imported)
            if name in of_extra:
                found["hardware/lab" if where.startswith("hardware/lab/") else where] = of_extra[name]
                assert not at_once or "hardware/lab" in where, f"{where} imports {name} as it is imported"
            else:
                assert name in {*sys.stdlib_module_names, *needed, "jaxscan", "hardware"}, f"{where}: {name}"
    assert found == BEHIND


def test_the_table_is_that_of_the_project():
    assert {name: set(packages) for name, (_, _, packages) in EXTRAS.items()} == {
        name: packages for name, packages in PACKAGES.items() if name not in ("gphoto2", "genicam")
    }


# The inputs are not there: what is missing is said before they are looked for.
USES = [
    ("plots", "mesh none.npz -o OUT/m.stl --png OUT/m.png"),
    ("plots", "merge a.npz b.npz --turn 90 -o OUT/m.stl --png OUT/m.png"),
    ("plots", "compare none.ply none.stl --png OUT/m.png"),
    ("plots", "view none.ply --png OUT/m.png"),
    ("plots", "calibrate none -o OUT/rig.json --report OUT/report"),
    ("plots", "inspect OUT/image.npz --png OUT/m.png"),
    ("viewer", "view none.ply"),
    ("rerun", "view none.ply --rerun OUT/m.rrd"),
    ("poisson", "mesh none.npz -o OUT/m.stl --method poisson"),
    ("poisson", "merge a.npz b.npz --turn 90 -o OUT/m.stl --closed"),
    ("simplify", "mesh none.npz -o OUT/m.stl --simplify 100"),
    ("simplify", "merge a.npz b.npz --turn 90 -o OUT/m.stl --simplify 100"),
    ("features", "merge a.npz b.npz -o OUT/m.stl"),
    ("exchange", "reconstruct none --rig none.json -o OUT/m.e57"),
    ("exchange", "reconstruct none --rig none.json -o OUT/m.laz"),
    ("mesh-scenes", "simulate OUT/world --mesh none.stl"),
    ("cluster", "batch none --rig none.json -o OUT/clouds --scheduler tcp://127.0.0.1:1"),
    ("lab", "serve --data OUT/lab"),
    ("lab", "user list --data OUT/lab"),
]


@pytest.mark.parametrize(("extra", "line"), USES, ids=[line.replace("OUT/", "") for _, line in USES])
def test_a_command_says_what_to_install(extra, line, without, tmp_path, capsys):
    without(extra)
    # What is drawn depends on the kind of file: it is there, and holds nothing.
    (tmp_path / "image.npz").touch()
    program = scanner if extra == "lab" else jaxscan
    assert program.main(line.replace("OUT", str(tmp_path)).split()) == 2
    out, err = capsys.readouterr()
    assert f'pip install "jaxscan[{extra}]"' in err
    assert out == ""
    assert [path.name for path in tmp_path.iterdir()] == ["image.npz"]


def test_every_extra_of_a_command_is_tried():
    assert {extra for extra, _ in USES} == set(EXTRAS)


# Nothing of what is given is looked at.
FUNCTIONS = [
    ("plots", lambda: surface_plots.draw_mesh("m.png", *[None] * 3, "")),
    ("plots", lambda: surface_plots.draw_range("m.png", None)),
    ("plots", lambda: surface_plots.draw_comparison("m.png", None, "")),
    ("plots", lambda: surface_plots.draw_view_data("m.png", None, "", "")),
    ("poisson", lambda: poisson_surface(None, None)),
    ("mesh-scenes", lambda: Mesh.create(None)),
]


@pytest.mark.parametrize(("extra", "call"), FUNCTIONS)
def test_a_function_says_what_to_install(extra, call, without):
    without(extra)
    with pytest.raises(InputError, match=rf'pip install "jaxscan\[{extra}\]"'):
        call()


@pytest.mark.parametrize(
    ("extra", "camera"), [("gphoto2", GPhotoCamera), ("genicam", lambda: GenICamCamera(Path("none.cti")))]
)
def test_a_camera_says_what_to_install(extra, camera, without):
    without(extra)
    with pytest.raises(CameraError, match=rf"pip install 'jaxscan\[{extra}\]'"):
        camera()
