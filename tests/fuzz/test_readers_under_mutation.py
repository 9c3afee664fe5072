"""Every reader of files reads or refuses whatever it is given: in time, in memory, by its own errors."""

from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.fuzz.campaign import case, run, shares
from tests.fuzz.kept import KEPT
from tests.fuzz.limits import Bench
from tests.fuzz.seeds import TARGETS
from tests.fuzz.targets import READERS


@pytest.fixture(scope="module")
def bench() -> Iterator[Bench]:
    with Bench() as bench:
        yield bench


def test_every_target_has_a_reader():
    assert TARGETS.keys() == READERS.keys()
    assert sum(share for _, share in shares(20_000)) == 20_000


@pytest.mark.parametrize("name", KEPT)
def test_what_was_not_borne_once(tmp_path: Path, bench: Bench, name: str):
    reader, made, text = KEPT[name]
    path = tmp_path / TARGETS[reader].file
    TARGETS[reader].seed(tmp_path)
    path.write_bytes(made())
    verdict = bench.judge(reader, path)
    assert verdict.outcome == ("refused" if text else "read"), verdict
    assert text in verdict.said, verdict


def test_seeds_are_read(tmp_path: Path, bench: Bench):
    for name in TARGETS:
        tally = run(bench, name, range(1))
        assert tally.outcomes == {"read": 1}, (name, tally.bad)


def test_five_hundred_mutants(bench: Bench):
    bad = {}
    for name, share in shares(500):
        tally = run(bench, name, range(1, 1 + share))
        bad |= {(name, number): verdict for number, verdict in tally.bad}
    assert not bad


@pytest.mark.long
@pytest.mark.parametrize("name", TARGETS)
def test_twenty_thousand_mutants(bench: Bench, name: str):
    tally = run(bench, name, range(1, 1 + dict(shares(20_000))[name]))
    assert not tally.bad


def test_a_case_is_its_name_and_number(tmp_path: Path):
    seed = TARGETS["rig 2"].seed(tmp_path)
    some = [case("rig 2", number, seed) for number in range(50)]
    assert some == [case("rig 2", number, seed) for number in range(50)]
    assert len(set(some)) > 40


def test_broken_readers_are_seen(tmp_path: Path):
    """The fuzzer can fail: each kind of fault is found, and the process is there again for the next case."""
    path = tmp_path / "a.txt"
    path.write_bytes(b"mutant")
    expected = {
        "good": "refused",
        "own warning": "read",
        "foreign": "foreign",
        "warns": "foreign",
        "nameless": "foreign",
        "slow": "hang",
        "hangs": "hang",
        "ends": "foreign",
    }
    with Bench("tests.fuzz.broken", longest_s=1.5) as bench:
        for reader, outcome in expected.items():
            assert bench.judge(reader, path).outcome == outcome, reader
            assert bench.judge("good", path).outcome == "refused", reader
        path.write_bytes(b"seed")
        assert bench.judge("foreign", path).outcome == "read"
    # A machine's first gigabyte can take seconds.
    with Bench("tests.fuzz.broken", longest_s=30) as bench:
        assert bench.judge("hungry", path).outcome == "hungry"
