"""What is known of each result of a batch: what it was made from, and what came of it, in a hidden file beside it.

The record of `a/b.ply` is `a/.b.ply.json`. It is written when work on a scan begins, with what the scan is then, and
again when its result is there. A result counts as done where the scan, the rig and the options are what they were at
the beginning: a scan that grew while it was read is made again, and so is one whose photographs were replaced.
"""

import hashlib
import json
from dataclasses import asdict, dataclass, field, fields
from pathlib import Path
from typing import Any

from jaxscan.atomic import replacing
from jaxscan.files.scan import Scan


@dataclass(frozen=True)
class Record:
    """Of one result.

    Attributes:
        scan: the scan's name in its tree.
        made_from: `digest_of` the scan when it was read.
        rig: digest of the rig's file.
        options: how it was reconstructed.
        version: of jaxscan.
        run: which batch made it: a word of its own for each.
        began: when, ISO 8601.
        size: bytes of the result; None until it is there.
        points: how many it has.
        frames: how many photographs were read.
        empty: how many of them have no point.
        seconds: how long it took.
        notes: what the photographs have shown to be wrong in the scan's settings.
        measured: what `batch --measure` found, and by which part.
    """

    scan: str
    made_from: str
    rig: str
    options: dict[str, Any]
    version: str
    run: str
    began: str
    size: int | None = None
    points: int | None = None
    frames: int | None = None
    empty: int | None = None
    seconds: float | None = None
    notes: tuple[str, ...] = ()
    measured: dict[str, Any] | None = field(default=None, compare=False)

    def is_of(self, result: Path) -> bool:
        """Whether this is the result that it speaks of, whole.

        Where the process was ended between writing the result and noting it, the result is younger than the record.
        """
        try:
            there = result.stat()
            if self.size is not None:
                return there.st_size == self.size
            return there.st_mtime_ns >= record_path(result).stat().st_mtime_ns
        except OSError:
            return False

    def write(self, result: Path) -> None:
        """Write it beside its result.

        Raises:
            InputError: it cannot be written.
        """
        with replacing(record_path(result), "w", durable=False) as file:
            json.dump(asdict(self), file, ensure_ascii=False, indent=1)


def record_path(result: Path) -> Path:
    """Where the record of a result stands."""
    return result.with_name(f".{result.name}.json")


def read_record(result: Path) -> Record | None:
    """The record of a result; None where there is none that can be read."""
    try:
        content = json.loads(record_path(result).read_bytes())
        known: dict[str, Any] = {each.name: content[each.name] for each in fields(Record) if each.name in content}
        known["notes"] = tuple(known["notes"])
        return Record(**known)
    except (OSError, ValueError, TypeError, KeyError):
        return None


def digest_of(scan: Scan) -> str:
    """What tells a scan from what it was before: its file's content, and name, size and time of all that it names.

    Raises:
        OSError: one of its files is gone.
    """
    digest = hashlib.sha256(scan.path.read_bytes())
    named = (*scan.frames, *scan.backgrounds, *(path for path in (scan.video, scan.poses) if path is not None))
    for path in named:
        there = path.stat()
        digest.update(f"{path.name}\0{there.st_size}\0{there.st_mtime_ns}\0".encode(errors="surrogateescape"))
    return digest.hexdigest()
