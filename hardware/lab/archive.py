"""A folder's files as one ZIP file, made while it is sent."""

import io
import zipfile
from collections.abc import Generator, Mapping, Sequence
from pathlib import Path
from typing import Final

_CHUNK: Final = 1 << 18


class _Sink(io.RawIOBase):
    """Takes what is written, until somebody fetches it."""

    def __init__(self) -> None:
        self._held = bytearray()

    def writable(self) -> bool:
        return True

    def write(self, data: bytes) -> int:  # pyright: ignore[reportIncompatibleMethodOverride]
        self._held += data
        return len(data)

    def fetch(self) -> bytes:
        data = bytes(self._held)
        self._held.clear()
        return data


def archive(folder: Path, texts: Mapping[str, bytes], files: Sequence[Path]) -> Generator[bytes, None, None]:
    """A ZIP file in chunks, all of it under the folder's name.

    Args:
        folder: what is handed out.
        texts: content of the files that may be changed meanwhile, by name.
        files: the others; photographs are compressed already, and stored as they are.
    """
    sink = _Sink()
    with zipfile.ZipFile(sink, "w", zipfile.ZIP_STORED) as made:
        for name, content in texts.items():
            made.writestr(f"{folder.name}/{name}", content)
        for file in dict.fromkeys(files):
            name = f"{folder.name}/{file.relative_to(folder).as_posix()}"
            with made.open(name, "w") as entry, file.open("rb") as source:
                while chunk := source.read(_CHUNK):
                    entry.write(chunk)
                    yield sink.fetch()
    yield sink.fetch()
