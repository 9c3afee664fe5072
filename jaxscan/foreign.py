"""Libraries that read files for us raise what they like, and warn in words that name no file: one wrapper for them."""

import os
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Final

from jaxscan.errors import InputError

_LONGEST_SHOWN: Final = 200


@contextmanager
def foreign(path: str | os.PathLike[str], problem: str, fix: str) -> Iterator[None]:
    """Turn whatever a library raises about a file into an `InputError` that names it; its warnings are dropped.

    Not for threads: Python's filters of warnings are one for the whole process.

    Args:
        path: the file.
        problem: what could not be done with it: "cannot be read as a mesh".
        fix: what to do about it.

    Raises:
        InputError: the library raised something; its own words are in the text.
    """
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")
            yield
    except InputError:
        raise
    except Exception as error:  # each library has its own
        said = " ".join(str(error).split())[:_LONGEST_SHOWN] or type(error).__name__
        raise InputError(f"{path}: {problem} ({said}): {fix}") from error
