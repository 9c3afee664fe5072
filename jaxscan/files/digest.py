"""What tells a file from another one: the first digits of its SHA-256."""

import hashlib
from pathlib import Path
from typing import Final

_DIGITS: Final = 16


def short_digest(path: Path) -> str:
    """Sixteen hexadecimal digits of the file's SHA-256.

    Raises:
        OSError: it cannot be read.
    """
    with path.open("rb") as opened:
        return hashlib.file_digest(opened, "sha256").hexdigest()[:_DIGITS]
