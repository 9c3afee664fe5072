"""Fits against NIST's reference pairs: data sets with their least-squares fits, right to the last digit.

("NIST reference pairs", of the algorithm testing and evaluation program for coordinate measuring systems; made by
ASME B89.4.10, public domain; by way of github.com/SumatPurewal/NistData.) These are the smallest of each kind. They are
ill-conditioned: a plane 0.3 µm off, pieces of a ball and of a cylinder, and cones of 65° and of 169°.
"""

import numpy as np
import pytest

from jaxscan.measurement.fit import Settled, finish
from jaxscan.measurement.scanned import scanned_points
from jaxscan.measurement.shapes import Ball, Cone, Cylinder, Plane

# Points as they are given, and of each fit a point, the direction, and sizes: a diameter; or the distance of the point
# from a cone's surface, and its whole angle in degrees.
PAIRS = {
    "pla3": (
        """
        116.28589 246.88068 379.92353 116.28594 246.05807 380.64652 116.28602 245.23542 381.36952
        116.28603 246.85165 379.89046 116.28589 246.02909 380.61369 116.28604 245.20646 381.33659
        """,
        (116.28596833333333333, 246.04356166666666667, 380.63005166666666667),
        (0.99999964494971137778, 0.00057991943628023643881, 0.00061138686492934729436),
        (),
    ),
    "sph2": (
        """
        468.17041 726.61315 495.99228 464.08922 724.78807 499.31255 467.6984 721.43878 501.91375
        471.78421 723.26261 498.5922 468.62439 727.84015 498.24217 465.43118 726.41198 500.83828
        468.25474 723.79346 502.87385 471.4508 725.22049 500.27704 468.74424 726.89642 501.52549
        """,
        (467.9370985150758033, 724.02643297922322102, 498.95364829657522846),
        (0.0, 0.0, 1.0),
        (7.878356848907474556,),
    ),
    "cyl2": (
        """
        580.4215 648.06718 -477.3922 580.18505 647.98305 -477.22411 580.14462 647.78989 -476.99635
        580.74499 649.21473 -476.36404 580.5087 649.13164 -476.19495 580.46792 648.93809 -475.96738
        581.06867 650.36321 -475.33434 580.83244 650.27897 -475.16665 580.79274 650.08635 -474.93786
        581.39266 651.51122 -474.30484 581.157 651.42736 -474.13675 581.1167 651.23448 -473.90906
        581.71658 652.65915 -473.27583 581.48098 652.57533 -473.10774 581.44095 652.3821 -472.87985
        582.04091 653.80752 -472.24664 581.80415 653.72353 -472.07916 581.76379 653.53034 -471.85073
        """,
        (581.32525620979540896, 650.66893190891241292, -474.55000463702699317),
        (0.20561439296272909606, 0.72871716896276960398, 0.65321819407105824746),
        (0.78374596793516903002,),
    ),
    "con3": (
        """
        6.62336 -465.82002 -26.36406 6.62352 -465.37047 -26.1534 6.62339 -465.20157 -25.68666
        6.66712 -465.79935 -26.81029 6.66719 -465.04056 -26.45433 6.66736 -464.7555 -25.66623
        6.64527 -465.80963 -26.58712 6.64534 -465.20552 -26.30398 6.64542 -464.97847 -25.67662
        """,
        (6.6463572203123117126, -465.85832048486977743, -25.705176715879492675),
        (0.99999890696440057574, 0.00081766875509273557856, -0.0012318635521301833316),
        (0.087218254341756148543, 168.6644310319288901),
    ),
    "con10": (
        """
        -355.66471 842.81405 217.287 -377.54316 845.27099 228.8148 -399.07945 835.44759 236.37929
        -414.51355 816.02183 237.94191 -339.33243 849.95261 238.47034 -367.99387 853.16904 253.58284
        -396.23567 840.30963 263.48742 -416.44694 814.85095 265.5396 -323.01048 857.13196 259.64798
        -358.45647 861.07805 278.34345 -393.37421 845.15463 290.58831 -418.38814 813.67553 293.12919
        """,
        (-366.40307730918735395, 793.44635459404152411, 234.19987738805830477),
        (0.42592656066745583091, -0.26897185898447100725, 0.8638522466211625884),
        (52.91694799823904824, 65.180025373214068101),
    ),
}


def reference(name):
    """The fit of a pair as a shape."""
    _, point, axis, sizes = PAIRS[name]
    point, axis = np.array(point), np.array(axis)
    if name.startswith("pla"):
        return Plane(point, axis, 1.0)
    if name.startswith("con"):
        half = np.radians(sizes[1]) / 2
        return Cone(point, axis, 1.0, sizes[0] / np.cos(half), half)
    return (Ball if name.startswith("sph") else Cylinder)(point, axis, 1.0, sizes[0] / 2)


@pytest.mark.parametrize("name", PAIRS)
def test_a_fit_is_nists(name):
    x = np.array(PAIRS[name][0].split(), float).reshape(-1, 3)
    known, every = reference(name), np.arange(len(x))
    start = known.placed(x)
    start = start.moved(0.03 * start.size * np.cos(np.arange(start.numbers) + 1.0))
    fit = finish(scanned_points(x), Settled(start, every, every, 0.0, np.zeros(len(x)), np.zeros(len(x))))
    found = fit.shape
    assert np.abs(start.distances(x)).max() > 10 * np.abs(fit.residuals).max()
    # Coordinates of 1000 mm are rounded at 1e-13.
    np.testing.assert_allclose(np.abs(found.distances(x)), np.abs(known.distances(x)), rtol=0, atol=3e-13)
    if not isinstance(known, Ball):
        assert np.linalg.norm(np.cross(found.axis, known.axis)) < 3e-13
    if not isinstance(known, Plane):
        assert found.radius == pytest.approx(known.placed(x).radius, abs=3e-12)
    if isinstance(known, Cone):
        assert found.axis @ known.axis > 0
        assert np.degrees(2 * found.half_angle) == pytest.approx(PAIRS[name][3][1], abs=3e-11)
