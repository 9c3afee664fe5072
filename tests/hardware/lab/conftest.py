"""Labs that the tests share."""

from collections.abc import Iterator
from pathlib import Path

import pytest
from serving import LEASE_S, Served, serve


@pytest.fixture
def served(tmp_path: Path) -> Iterator[Served]:
    """A lab whose stage is there at once."""
    served = serve(tmp_path / "lab")
    yield served
    served.end()


@pytest.fixture
def slow(tmp_path: Path) -> Iterator[Served]:
    """A lab whose stage takes time, ten times less than a real one, and stands at step 0."""
    served = serve(tmp_path / "lab", speed=10)
    served.stage.home()
    yield served
    served.end()


@pytest.fixture
def brief(tmp_path: Path) -> Iterator[Served]:
    """The same with a lease of a second."""
    served = serve(tmp_path / "lab", speed=10, lease_s=LEASE_S)
    served.stage.home()
    yield served
    served.end()


@pytest.fixture(scope="module")
def lasting(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """A lab for all tests of a file that leave it as it is."""
    served = serve(tmp_path_factory.mktemp("lasting") / "lab")
    yield served
    served.end()
