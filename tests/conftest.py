"""What all tests share: where the real data are, and strict JAX."""

import fcntl
import os
from collections.abc import Iterator
from pathlib import Path

import jax
import pytest

jax.config.update("jax_numpy_rank_promotion", "raise")


@pytest.fixture(scope="session")
def data() -> Path:
    """The folder of real photographs and reference problems, which is not part of the repository."""
    folder = os.environ.get("JAXSCAN_DATA")
    if not folder:
        pytest.skip("JAXSCAN_DATA is not set: it names the folder of real photographs and reference problems")
    return Path(folder)


@pytest.fixture(scope="session")
def world(tmp_path_factory: pytest.TempPathFactory, worker_id: str) -> Path:
    """Photographs and what the commands make of them, `small_world.make`: made by one worker, read by all."""
    folder = tmp_path_factory.getbasetemp()
    if worker_id != "master":
        folder = folder.parent
    with open(folder / "world.lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "world").is_dir():
            from tests.small_world import make

            make(folder / "making")
            (folder / "making").rename(folder / "world")
    return folder / "world"


@pytest.fixture
def x64() -> Iterator[None]:
    """Float64 for one test; the others run in JAX's default precision."""
    with jax.enable_x64(True):
        yield


def pytest_addoption(parser: pytest.Parser) -> None:
    """What takes long by itself, mostly to compile, is run on request."""
    parser.addoption("--long", action="store_true", help="also the tests that take long")


def pytest_collection_modifyitems(config: pytest.Config, items: list[pytest.Item]) -> None:
    """Skip them by name otherwise."""
    if not config.getoption("--long"):
        for item in items:
            if item.get_closest_marker("long"):
                item.add_marker(pytest.mark.skip(reason="takes long: run with --long"))
