import numpy as np
import pytest

from jaxscan.cli.main import main
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.rig import LightPlane
from jaxscan.rig.light import distance
from jaxscan.simulation import rig_2003
from jaxscan.simulation.profile import true_profile
from jaxscan.simulation.render import render


def test_a_bowed_sheet_is_drawn_where_it_is():
    rig = rig_2003.simulated_rig(0, bow_mm=2.0)
    light = rig.lights[0]
    assert light.sag(100.0, 350.0) == pytest.approx(2.0)
    scene = rig_2003.board_scene(np.zeros(3), np.array([-64.0, -50.0, 350.0]))
    profile = true_profile(rig, scene)
    seen = np.isfinite(profile.position)
    assert seen.sum() > 250
    np.testing.assert_allclose(distance(light, profile.points[seen]), 0, atol=1e-6)
    assert np.ptp(distance(LightPlane(light.plane), profile.points[seen])) > 0.5
    image = render(rig, scene, laser=0, seed=0)
    found = detect_stripe(image[None], StripeSettings("red"), detector="gravity").position[0]
    both = seen & np.isfinite(found)
    assert both.sum() > 200
    assert np.median(np.abs(found - profile.position)[both]) < 0.1


def test_a_bow_that_no_sheet_has_is_refused(tmp_path, capsys):
    assert main(["simulate", str(tmp_path / "out"), "--sheet-bow-mm", "50"]) == 2
    assert "--sheet-bow-mm 50: give -5 to 5" in capsys.readouterr().err
