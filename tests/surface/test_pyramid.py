"""The real pyramid: the sign of its stage, its faces, its slopes."""

import numpy as np
import pytest

from benchmarks import surface as benchmark


def test_a_pyramid(data, monkeypatch: pytest.MonkeyPatch):
    monkeypatch.setenv("JAXSCAN_DATA", str(data))
    found = {metric.name.removeprefix("surface.pyramid."): metric for metric in benchmark.pyramid()}
    assert found["facing_away.stage_plus"].value > 0.05
    assert found["facing_away.stage_minus"].value < 0.01
    assert found["share_further_than_1_mm"].value < 0.02
    for name in ("top", *(f"face_{i}" for i in range(4))):
        assert found[f"{name}.rms"].value < 0.3
    assert max(found["slopes_0_and_2_apart"].value, found["slopes_1_and_3_apart"].value) < 3.0
    assert np.isfinite([metric.value for metric in found.values()]).all()
