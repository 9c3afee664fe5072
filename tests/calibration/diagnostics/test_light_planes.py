"""A light plane beside which its own stripes lie is marked; noise of single points says nothing against it."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxscan.calibration import Observations, calibrate
from jaxscan.calibration.diagnostics.light_planes import light_plane_doubts
from jaxscan.calibration.diagnostics.stripe_shapes import stripe_shapes
from jaxscan.calibration.observe import observe
from jaxscan.files.rig_file import read_rig, write_rig
from jaxscan.files.session import read_session
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_session
from tests.calibration import synthetic
from tests.calibration.synthetic import Noise


def thick(session: Observations, jumps_px: float) -> Observations:
    """The middle of a line as thick as the squares: it jumps from square to square."""
    random = np.random.default_rng(0)
    views = []
    for view in session.views:
        (stripe,) = view.stripes
        jumps = np.repeat(jumps_px * random.normal(size=40), 16)
        moved = stripe.pixels + np.stack([np.zeros(640), jumps], axis=-1)
        views.append(replace(view, stripes=(replace(stripe, pixels=moved),)))
    return replace(session, views=tuple(views))


def test_a_line_as_thick_as_the_squares_is_marked_in_the_rigs_file(session, tmp_path: Path):
    result = calibrate(thick(session, 6.0))
    (doubt,) = result.warnings
    assert "does not fit the stripes that it was found from" in doubt
    write_rig(tmp_path / "rig.json", result.rig_file())
    assert read_rig(tmp_path / "rig.json").warnings == (doubt,)


def test_a_good_rig_and_a_noisy_one_are_not_marked(calibration):
    assert calibration.warnings == ()
    assert "warnings" not in calibration.rig_file().fit
    noisy = calibrate(synthetic.observations(seed=0, n_stage=5, noise=Noise(0.05, 5.0)))
    assert noisy.stripe_sigma_px == pytest.approx(5.0, rel=0.1)
    assert noisy.warnings == ()


def test_what_noise_gives_the_running_mean_is_not_counted(calibration):
    for found in stripe_shapes(calibration):
        assert found.tied_mm < 0.5 * found.noise_mm
    assert light_plane_doubts(()) == ()


@pytest.mark.long
@pytest.mark.parametrize(("sheet_sigma_mm", "marked"), [(0.25, False), (5.0, True)])
def test_photographs_of_a_thick_line(tmp_path: Path, sheet_sigma_mm: float, marked: bool):
    """60 px of light on squares of 30: the plane that comes of it is degrees off."""
    lighting = replace(rig_2003.BOARD_LIGHTING, sheet_sigma_mm=sheet_sigma_mm)
    simulate_session(tmp_path, 2, views=8, stage_views=2, separate_stripes=True, lighting=lighting)
    result = calibrate(observe(read_session(tmp_path)))
    assert bool(result.warnings) == marked
