"""The errors that jaxscan raises on purpose: each text names the file, the value, and how to fix it."""

import os
from collections.abc import Iterator
from contextlib import contextmanager


class JaxscanError(Exception):
    """The base class of jaxscan's errors; the text gives the reason and how to fix it."""


class InputError(JaxscanError):
    """Something that the user gave is wrong: a file, a key, an option, an array's shape."""


class ObservabilityError(InputError):
    """The photographs do not determine what was asked of them."""


class SolveError(JaxscanError):
    """The solve did not reach a minimum."""


class StalledError(JaxscanError):
    """Something that was waited for did not end in time."""


@contextmanager
def error_context(where: str | os.PathLike[str]) -> Iterator[None]:
    """Put the file, and the key, before the text of an `InputError`, unless it names them already."""
    try:
        yield
    except InputError as error:
        if str(error).startswith(f"{where}: "):
            raise
        raise type(error)(f"{where}: {error}") from error
