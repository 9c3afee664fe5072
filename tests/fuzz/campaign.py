"""A number of cases of each reader, each a function of its reader's name and its number."""

import tempfile
from collections import Counter
from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from random import Random

from tests.fuzz.limits import Bench, Verdict
from tests.fuzz.seeds import TARGETS


@dataclass
class Tally:
    """How the cases of one reader ended; of the bad ones the first few, each with its number."""

    outcomes: Counter[str] = field(default_factory=Counter)
    bad: list[tuple[int, Verdict]] = field(default_factory=list)
    longest_s: float = 0.0
    most_bytes: int = 0

    def add(self, number: int, verdict: Verdict) -> None:
        """One case more."""
        self.outcomes[verdict.outcome] += 1
        self.longest_s = max(self.longest_s, verdict.took_s)
        self.most_bytes = max(self.most_bytes, verdict.grew)
        if verdict.bad:
            self.bad.append((number, verdict))


def case(name: str, number: int, seed: bytes) -> bytes:
    """The bytes of a case; number 0 is the seed itself."""
    return TARGETS[name].mutant(seed, Random(f"{name} {number}")) if number else seed


def run(bench: Bench, name: str, numbers: range) -> Tally:
    """Read these cases of one reader."""
    tally = Tally()
    with tempfile.TemporaryDirectory(prefix="fuzz-") as folder:
        target = TARGETS[name]
        path = Path(folder) / target.file
        seed = target.seed(Path(folder))
        for number in numbers:
            path.write_bytes(case(name, number, seed))
            tally.add(number, bench.judge(name, path))
    return tally


def shares(cases: int) -> Iterator[tuple[str, int]]:
    """How many of the `cases` cases each reader has."""
    for i, name in enumerate(TARGETS):
        yield name, (cases + i) // len(TARGETS)
