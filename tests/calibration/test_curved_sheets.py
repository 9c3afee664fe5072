import re
from dataclasses import replace

import jax
import numpy as np
import pytest

from jaxscan.calibration import Observations, calibrate
from jaxscan.errors import InputError, ObservabilityError
from tests.calibration import sheets, synthetic


def short(session: Observations, first: int, last: int) -> Observations:
    """Each stripe between two columns alone."""
    views = []
    for view in session.views:
        pixels = view.stripes[0].pixels.copy()
        pixels[~((pixels[:, 0] >= first) & (pixels[:, 0] < last))] = np.nan
        views.append(replace(view, stripes=(replace(view.stripes[0], pixels=pixels),)))
    return replace(session, views=tuple(views))


@pytest.mark.parametrize("sag", [0.3, -2.0])
def test_the_cone_of_a_cylinder_lens_is_found(sag):
    session = sheets.session(1, sheets.cone(sag))
    flat, found = calibrate(session), calibrate(session, light="bowed")
    light, sigma = found.rig.lights[0], found.covariance.sigma("lights.0.bow.0")
    to_mm = light.sag(100.0, sheets.DEPTH) / float(light.bow[0])
    # Where the laser stands, and what it adds beyond the parabola, is worth a hundredth of it.
    assert abs(light.sag(100.0, sheets.DEPTH) - sag) < 4 * sigma * to_mm + 0.01 * abs(sag)
    assert sigma * to_mm < 0.01
    assert found.stripe_rms_px < 0.102
    assert flat.stripe_rms_px > 1.5 * found.stripe_rms_px


def test_a_flat_sheet_taken_as_bowed_is_flat():
    session = sheets.session(2, sheets.cone(0.0))
    flat, bowed = calibrate(session), calibrate(session, light="bowed")
    assert abs(float(bowed.rig.lights[0].bow[0])) < 4 * bowed.covariance.sigma("lights.0.bow.0")
    for name in ("camera.focal.0", "camera.radial.0"):
        assert bowed.covariance.sigma(name) < 1.02 * flat.covariance.sigma(name)
    np.testing.assert_allclose(jax.tree.leaves(bowed.rig.camera), jax.tree.leaves(flat.rig.camera), rtol=1e-3)


def test_a_bow_that_short_stripes_leave_open_is_refused_with_the_photograph_that_is_missing():
    session = short(sheets.session(1, sheets.cone(0.3)), 300, 316)
    with pytest.raises(
        ObservabilityError,
        match=r"the bow of the sheet of light .* Let the stripe cross a board at both of its ends, near the edges of "
        "the image, .* or take the sheet as flat",
    ):
        calibrate(session, light="bowed")


def test_a_bow_no_better_than_its_sigma_is_said_to_be_none():
    """A bow of 0.34 ± 0.06 mm is not remarked on; one of 1.7 ± 1.2 mm once was not either."""
    session = sheets.session(1, sheets.cone(0.3))
    assert calibrate(short(session, 270, 370), light="bowed").notes == ()
    assert calibrate(short(session, 305, 335)).notes == ()
    (note,) = calibrate(short(session, 305, 335), light="bowed").notes
    expected = r"the bow of the sheet of light, 1\.\d ± 1 mm over 200 mm, cannot be distinguished from none: .*plane"
    assert re.match(expected, note)


def test_stripes_at_one_distance_leave_the_sheet_open():
    poses = 0

    def twice_in_one_place(rng):
        nonlocal poses
        poses += 1
        R, t = synthetic.board_pose(rng)
        return (np.eye(3), np.array([0.0, 0.0, 345.0]) - synthetic.BOARD.points().mean(axis=0)) if poses < 3 else (R, t)

    session = sheets.session(1, sheets.cone(0.3), pose=twice_in_one_place)
    views = (*session.views[:2], *(replace(view, stripes=()) for view in session.views[2:]))
    with pytest.raises(ObservabilityError, match="at distances that differ by a third and more"):
        calibrate(replace(session, views=views), light="bowed")


def test_each_laser_has_a_kind_of_its_own():
    session = sheets.session(1, sheets.cone(0.3))
    found = calibrate(session, light=["bowed"])
    assert found.rig.lights[0].kind == "bowed"
    dark = replace(session, views=tuple(replace(view, stripes=()) for view in session.views), lasers=())
    with pytest.raises(InputError, match='light = "bowed": no laser was observed'):
        calibrate(dark, light="bowed")
    with pytest.raises(InputError, match="light names 2 kinds for 1 lasers"):
        calibrate(session, light=["bowed", "plane"])
    with pytest.raises(InputError, match='light = "wavy": this version knows plane, bowed'):
        calibrate(session, light="wavy")
