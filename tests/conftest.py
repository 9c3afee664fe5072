"""What all tests share: where the real data are, and strict JAX."""

import os
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

import jax
import pytest

if TYPE_CHECKING:
    from jaxscan.calibration import Calibration, Observations

jax.config.update("jax_numpy_rank_promotion", "raise")


# A process may have 65530 areas of memory unless the system says otherwise, and each compiled function takes some.
_MAPS = Path("/proc/self/maps")
_MANY_MAPS = 30_000


@pytest.fixture(scope="module", autouse=True)
def few_maps() -> Iterator[None]:
    """Forget compiled functions before there are too many for one process: the next one to compile would abort it."""
    yield
    if _MAPS.exists() and _MAPS.read_text().count("\n") > _MANY_MAPS:
        jax.clear_caches()


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real photographs and reference problems, which is not part of the repository."""
    folder = os.environ.get("JAXSCAN_DATA")
    if not folder:
        pytest.skip("JAXSCAN_DATA is not set: it names the folder of real photographs and reference problems")
    return Path(folder)


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """Photographs and what the commands make of them, `small_world.make`."""
    from tests.small_world import make

    folder = tmp_path_factory.mktemp("small") / "world"
    make(folder)
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


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip them by name otherwise."""
    if not config.getoption("--long"):
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason="takes long: run with --long"))


# Modules that share what is dear to make: one worker runs them all.
_TOGETHER = {
    "calibrated": ("tests/calibration/", "tests/view/"),
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
