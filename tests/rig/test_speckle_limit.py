import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.rig import Camera, LightPlane, Rig
from jaxscan.rig.speckle_limit import Optics, speckle_limit, uncertainty


def test_the_formula_by_hand():
    # 650 nm, sin u = 0.01, sin θ = 0.5: 0.00065 / (2π · 0.005) = 0.020690 mm.
    assert uncertainty(1.0, 0.00065, np.array([0.01]), np.array([0.5])) == pytest.approx(0.020690, abs=1e-6)


def test_a_point_on_the_axis_by_hand():
    # f = 1600 px of 5 µm = 8 mm; at f/4 half the aperture is 1 mm, 400 mm away: sin u = 0.0025. The sheet stands at 30°
    # to the axis, (−cos 30°, 0, sin 30°) · (X − (0, 0, 400)) = 0.
    camera = Camera.create((640, 480), np.array([1600.0, 1600.0]), np.array([320.0, 240.0]), "none")
    normal = np.array([-np.cos(np.pi / 6), 0.0, 0.5])
    rig = Rig(camera, (LightPlane.create(normal / (normal @ [0, 0, 400.0])),))
    point = np.array([[0.0, 0.0, 400.0]])
    found = speckle_limit(rig, point, Optics(4.0, 650.0, 5.0))
    assert found == pytest.approx(0.00065 / (2 * np.pi * 0.0025 * 0.5), rel=1e-4)
    assert speckle_limit(rig, point, Optics(4.0, 650.0, 5.0), 0.2) == pytest.approx(0.2 * found)
    with pytest.raises(InputError, match="has no laser"):
        speckle_limit(Rig(camera, ()), point, Optics(4.0, 650.0, 5.0))


@pytest.mark.parametrize(
    ("optics", "said"),
    [
        ((0.0, 650.0, 5.0), r"f_number = 0: focal length over the aperture's diameter is 0\.5 to 64$"),
        ((0.125, 650.0, 5.0), r"f_number = 0\.125: .*; did you mean 8\?"),
        ((4.0, 650e-9, 5.0), r"wavelength_nm = 6\.5e-07: in nanometres .* 380 to 780; did you mean 650\?"),
        ((4.0, 0.00065, 5.0), r"did you mean 650\?"),
        ((4.0, 0.65, 5.0), r"did you mean 650\?"),
        ((4.0, 6328.0, 5.0), r"did you mean 632\.8\?"),
        ((4.0, 65.0, 5.0), r"380 to 780$"),
        ((4.0, np.nan, 5.0), r"380 to 780$"),
        ((4.0, 650.0, 4.8e-6), r"pixel_um = 4\.8e-06: in micrometres .*; did you mean 4\.8\?"),
        ((4.0, 650.0, 0.0048), r"did you mean 4\.8\?"),
        ((4.0, 650.0, 4800.0), r"did you mean 4\.8\?"),
    ],
)
def test_what_no_lens_laser_or_sensor_has_is_refused(optics, said):
    with pytest.raises(InputError, match=said):
        Optics(*optics)


@pytest.mark.parametrize("optics", [(0.5, 200.0, 0.5), (64.0, 2000.0, 50.0), (0.95, 405.0, 0.56), (22.0, 1550.0, 24.0)])
def test_real_ones_are_taken(optics):
    assert Optics(*optics).f_number == optics[0]
