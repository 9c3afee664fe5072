"""Sessions on a bad line: none hangs, none believes a wrong position, each ends well or says what to do."""

from benchmarks.serial_sessions import session

_DO = ("check", "home", "plug", "switch")


def test_a_hundred_sessions_with_random_faults():
    outcomes = [session(seed) for seed in range(100)]
    assert {outcome.fault for outcome in outcomes} == {""}
    # The faults are there, and are survived.
    assert sum(not outcome.error for outcome in outcomes) > 40
    assert sum(bool(outcome.error) for outcome in outcomes) > 20
    assert all(any(word in outcome.error for word in _DO) for outcome in outcomes if outcome.error)
    assert sum(outcome.places for outcome in outcomes) > 400


def test_a_session_is_its_seed():
    assert session(5).seconds == session(5).seconds
