"""Which way a stripe runs over the image, against the stripe that is drawn on a plate that faces the camera."""

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.images import StripeSettings
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction.scan_checks import check_lines
from jaxscan.rig import Camera, LightPlane, Rig
from jaxscan.rig.bowed_sheet import BowedSheet
from jaxscan.rig.stripe_way import steep_notes, stripe_slope

DEPTH_MM, BOW = 300.0, 3.0


def rig_of(light):
    with float64():
        camera = Camera.create((640, 480), (700.0, 690.0), (320.0, 240.0), "radial1", (-0.1,))
        return as_numpy(Rig(camera, (light,)))


def drawn_slope(rig):
    """Of the stripe on a plate at 300 mm, by projection of points of sheet and plate near the image's middle."""
    (x, y, z), line = rig.lights[0].plane, np.linspace(-1.0, 1.0, 3)
    # ω · X = 1 at the plate's depth: the nearest point to the camera's axis, and along the line from there.
    left = 1 - z * DEPTH_MM
    begin, way = np.array([x, y]) * left / (x * x + y * y), np.array([-y, x]) / np.hypot(x, y)
    points = np.array([[*(begin + t * way), DEPTH_MM] for t in line])
    u, v = np.asarray(rig.camera.project(points)).T
    return abs((v[2] - v[0]) / (u[2] - u[0]))


@pytest.mark.parametrize("turn_deg", [0.0, 10.0, 45.0, 80.0, 100.0])
def test_a_stripe_runs_as_it_is_drawn(turn_deg):
    turn = np.radians(turn_deg)
    rig = rig_of(LightPlane.create([0.004 * np.sin(turn), 0.004 * np.cos(turn), 0.0033]))
    assert stripe_slope(rig, "") == pytest.approx(drawn_slope(rig), rel=0.02, abs=0.01)


def test_a_bowed_sheet_runs_as_its_plane_does():
    plane = [0.001, 0.004, 0.002]
    flat, bowed = (
        stripe_slope(rig_of(light), "") for light in (LightPlane.create(plane), BowedSheet.create(plane, BOW))
    )
    assert flat == pytest.approx(0.25, rel=0.05)
    assert bowed == pytest.approx(flat, rel=0.1)
    assert bowed != flat


@pytest.mark.parametrize(
    ("omega", "columns", "says"),
    [
        ([0.0005, 0.004, 0.003], True, None),
        ([0.004, 0.0005, 0.003], False, None),
        ([0.004, 0.003, 0.003], True, None),
        ([0.003, 0.004, 0.003], False, None),
        ([0.004, 0.0005, 0.003], True, "one point in each column, .* runs up and down .* set columns = false"),
        ([0.004, 0.0, 0.003], True, "set columns = false"),
        ([0.0005, 0.004, 0.003], False, "one point in each row, .* from left to right .* set columns = true"),
        ([0.0, 0.004, 0.003], False, "set columns = true"),
    ],
)
def test_a_stripe_that_is_looked_for_across_its_way_is_refused(omega, columns, says):
    rig, laser = rig_of(LightPlane.create(omega)), StripeSettings("red", columns)
    if says is None:
        check_lines(rig, laser, "scan.toml")
        return
    with pytest.raises(InputError, match=rf"^scan\.toml: looks for {says}|^scan\.toml: .*{says}"):
        check_lines(rig, laser, "scan.toml")


@pytest.mark.parametrize(("omega", "notes"), [([0.004, 0.003, 0.003], 0), ([0.004, 0.0017, 0.003], 1)])
def test_a_steep_stripe_is_measured_and_spoken_of(omega, notes):
    rig, laser = rig_of(LightPlane.create(omega)), StripeSettings("red", True)
    check_lines(rig, laser, "scan.toml")
    said = steep_notes(rig, laser.name, "over the image by this rig", columns=laser.columns)
    assert len(said) == notes
    assert all("set columns = false" in note for note in said)
