"""What all tests share: where the real data are, and strict JAX."""

import ctypes
import gc
import os
import shutil
import time
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

# Several processes share the cores: threads of BLAS would wait for each other by turning, and double the time. Before
# NumPy is there; what pytest starts has it from here.
os.environ.setdefault("OPENBLAS_NUM_THREADS", "1")

import jax
import pytest
from jaxtyping import config as checks

from jaxscan.exclusive import InUseError, exclusive

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration, Observations

jax.config.update("jax_numpy_rank_promotion", "raise")


# A process may have 65530 areas of memory unless the system says otherwise, and each compiled function takes some.
# Three processes share the memory.
_MAPS, _MEMORY = Path("/proc/self/maps"), Path("/proc/self/statm")
_MANY_MAPS, _MUCH_MEMORY = 30_000, 3 << 30
# Where shapes are checked at every call: the mathematics' own tests. Elsewhere the same functions are called again.
_CHECKED = ("tests/geometry/", "tests/rig/", "tests/calibration/", "tests/reconstruction/", "tests/test_elimination.py")


@pytest.fixture(scope="module", autouse=True)
def checked_shapes(request: pytest.FixtureRequest) -> Iterator[None]:
    """Shapes are checked at each call by the tests of what has them alone: it costs a quarter of the time.

    With `--long` all tests check them.
    """
    checked = request.config.getoption("--long") or request.node.nodeid.startswith(_CHECKED)
    checks.update("jaxtyping_disable", not checked)
    yield
    checks.update("jaxtyping_disable", False)


@pytest.fixture(scope="module", autouse=True)
def few_maps() -> Iterator[None]:
    """Forget compiled functions before there are too many for one process, or they take too much memory.

    With too many areas of memory the next one to compile would abort the process.
    """
    yield
    if not _MAPS.exists():
        return
    resident = int(_MEMORY.read_text().split()[1]) * os.sysconf("SC_PAGE_SIZE")
    if _MAPS.read_text().count("\n") > _MANY_MAPS or resident > _MUCH_MEMORY:
        jax.clear_caches()
        gc.collect()
        # What the compiler has freed is held for its next use otherwise, which is most of it.
        if hasattr(libc := ctypes.CDLL(None), "malloc_trim"):
            libc.malloc_trim(0)


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real photographs and reference problems, which is not part of the repository."""
    folder = os.environ.get("JAXSCAN_DATA")
    if not folder:
        pytest.skip("JAXSCAN_DATA is not set: it names the folder of real photographs and reference problems")
    return Path(folder)


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """Photographs and what the commands make of them, `small_world.make`; made once for all processes."""
    from tests.small_world import make

    base = tmp_path_factory.getbasetemp()
    folder = (base if worker_id == "master" else base.parent) / "small" / "world"
    folder.parent.mkdir(exist_ok=True)
    made = folder.parent / "made"
    while not made.exists():
        try:
            with exclusive(folder.parent / "lock", "the small world"):
                if not made.exists():
                    # A process whose time ran out leaves a half.
                    shutil.rmtree(folder, ignore_errors=True)
                    make(folder)
                    made.touch()
        except InUseError:
            time.sleep(0.2)
    return folder


@pytest.fixture(scope="session")
def session() -> "Observations":
    """Eleven views and five stage photographs of the rig of 2003, drawn with noise."""
    from tests.calibration import synthetic

    return synthetic.observations(seed=0, n_stage=5)


@pytest.fixture(scope="session")
def calibration(session: "Observations") -> "Calibration":
    """What `calibrate` makes of them: its solve compiles once for all tests that look at it."""
    from jaxscan.calibration import calibrate

    return calibrate(session)


@pytest.fixture
def x64() -> Iterator[None]:
    """Float64 for one test; the others run in JAX's default precision."""
    with jax.enable_x64(True):
        yield


@pytest.fixture
def own_kinds() -> Iterator[None]:
    """The kinds of parts that a test registers are forgotten after it."""
    from jaxscan.rig import LENSES, LIGHTS, MOTIONS

    before = [(kinds, dict(kinds)) for kinds in (LENSES, LIGHTS, MOTIONS)]
    yield
    for kinds, known in before:
        kinds.clear()
        kinds.update(known)


def pytest_addoption(parser: pytest.Parser) -> None:
    """What takes long by itself, mostly to compile, is run on request."""
    parser.addoption("--long", action="store_true", help="also the tests that take long")


def pytest_collection_finish(session: pytest.Session) -> None:
    """What was imported stays: to look through all of it for garbage again and again takes a tenth of the time."""
    gc.collect()
    gc.freeze()
    gc.set_threshold(10_000, 10, 10)


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip them by name otherwise."""
    if not config.getoption("--long"):
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason="takes long: run with --long"))


# Modules that share what is dear to make: one worker runs them all. No group takes longer than all else does to the
# other workers: at the end they would wait for it.
_TOGETHER = {
    "calibrated": ("tests/calibration/test_",),
    "diagnosed": ("tests/calibration/diagnostics/", "tests/view/", "tests/measurement/test_gradient.py"),
    "small world": ("tests/test_docs.py", "tests/test_end_to_end.py", "tests/test_examples.py"),
}


def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """A worker takes whole modules, and of those that share fixtures all."""
    from xdist.scheduler import LoadScopeScheduling

    class ByFixtures(LoadScopeScheduling):
        def _split_scope(self, nodeid: str) -> str:
            module = super()._split_scope(nodeid)
            return next((name for name, paths in _TOGETHER.items() if module.startswith(paths)), module)

    return ByFixtures(config, log)
