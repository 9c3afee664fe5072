"""What came of each scan of a batch, as it comes: kept as a table that other programs read, `batch.csv`."""

import time
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from jaxscan.errors import InputError
from jaxscan.missing import listed

if TYPE_CHECKING:
    from jaxscan.reconstruction.batch import Options, Outcome, Tree
    from jaxscan.reconstruction.records import Record

TABLE: Final = "batch.csv"
# The table is written again after this long while the batch goes on, s.
_AGAIN_S: Final = 15.0
_HEADS: Final = ("scan", "state", "points", "frames", "empty", "seconds", "made", "version", "notes", "reason")


def notes_in_words(scans: Iterable[Mapping[str, Any]]) -> list[str]:
    """A line for each note, with the scans that have it.

    Args:
        scans: of each its name under `scan`, and its `notes`.
    """
    names: dict[str, list[str]] = {}
    for one in scans:
        for note in one["notes"]:
            names.setdefault(note, []).append(one["scan"])
    return [f"note: {listed(each, 'and')}: {note}" for note, each in names.items()]


@dataclass
class Log:
    """What is known of the scans of a batch.

    Attributes:
        path: of the table.
        tree: the scans.
        options: how they are reconstructed.
        records: of the results that are there, of these scans as they are now, by the scans' names.
        kept: those that were there before.
        made: those that this batch has made.
        failed: why others are not there.
    """

    path: Path
    tree: "Tree"
    options: "Options"
    records: "dict[str, Record]"
    kept: set[str]
    made: set[str] = field(default_factory=set)
    failed: dict[str, str] = field(default_factory=dict)
    _written: float = field(default_factory=time.monotonic)

    @staticmethod
    def begun(path: Path, tree: "Tree", rig: Path, options: "Options") -> "Log":
        """With what is there before anything is made."""
        from jaxscan.cli.progress import step
        from jaxscan.files.digest import short_digest

        step("looking what is there")
        digest = short_digest(rig)
        known = {task.name: task.done(digest, options) for task in tree.tasks}
        records = {name: record for name, record in known.items() if record is not None}
        return Log(path, tree, options, records, set(records), failed=dict(tree.refused))

    def add(self, outcome: "Outcome") -> None:
        """Take up what came of one scan."""
        name = outcome.task.name
        if outcome.record is None:
            self.records.pop(name, None)
            self.failed[name] = outcome.reason
        else:
            self.records[name] = outcome.record
            self.made.add(name)
        if time.monotonic() - self._written > _AGAIN_S:
            self.write()

    def write(self) -> None:
        """Write the table, a line for each scan; where that cannot be, as on a full disk, it is said."""
        from jaxscan.cli.progress import say
        from jaxscan.files.measured_csv import write_lines

        lines = [self._line(name) for name in dict.fromkeys([*(task.name for task in self.tree.tasks), *self.failed])]
        try:
            write_lines(self.path, _HEADS, lines)
        except InputError as error:
            say(f"jaxscan: warning: {error}")
        self._written = time.monotonic()

    def _line(self, name: str) -> list[object]:
        record, reason = self.records.get(name), self.failed.get(name)
        if record is None:
            return [name, "open" if reason is None else "failed", *[None] * (len(_HEADS) - 3), reason]
        state = "made" if name in self.made else "kept"
        counts = [record.points, record.frames, record.empty, record.seconds]
        return [name, state, *counts, record.began, record.version, "; ".join(record.notes), reason]
