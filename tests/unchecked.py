"""Without checks of shapes for a while: for what a test does again and again, once it was checked."""

from collections.abc import Iterator
from contextlib import contextmanager

from jaxtyping import config as checks


@contextmanager
def unchecked() -> Iterator[None]:
    """Checks are a fifth of the time of a calibration that has been compiled."""
    before = checks.jaxtyping_disable
    checks.update("jaxtyping_disable", True)
    try:
        yield
    finally:
        checks.update("jaxtyping_disable", before)
