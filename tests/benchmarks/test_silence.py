"""How long a command leaves the screen alone, as `benchmarks.silence` watches it."""

import pytest

from benchmarks.silence import watched


def test_a_command_speaks_soon_and_keeps_speaking(world, tmp_path):
    """Limits that a loaded machine keeps too: the benchmark has those that count."""
    first, still, whole = watched(["inspect", str(world / "cup.npz"), "--png", "views.png"], tmp_path, tmp_path / "c")
    assert 0 < first <= still <= whole
    assert first < 15
    assert still < 20
    assert (tmp_path / "views.png").exists()


def test_a_command_that_fails_is_no_figure(tmp_path):
    with pytest.raises(RuntimeError, match=r"inspect gone.npz ended with status 2: .*there is no such file"):
        watched(["inspect", "gone.npz"], tmp_path, tmp_path / "c")
