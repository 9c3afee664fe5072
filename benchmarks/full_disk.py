"""A disk that is full, for one process alone."""

import resource
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def full(pid: int) -> Iterator[None]:
    """No file of the process grows any more."""
    before = resource.prlimit(pid, resource.RLIMIT_FSIZE)
    resource.prlimit(pid, resource.RLIMIT_FSIZE, (1, before[1]))
    try:
        yield
    finally:
        resource.prlimit(pid, resource.RLIMIT_FSIZE, before)
