"""Albedo: of a drawn surface whose stripe follows the law exactly, and of rendered photographs."""

from dataclasses import replace

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.scan import read_scan
from jaxscan.precision import as_numpy
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.rig import LightPlane
from jaxscan.rig.light import laser_place
from jaxscan.simulation import rig_2003
from jaxscan.simulation.folders import simulate_scan
from jaxscan.simulation.scene import Body
from jaxscan.simulation.solids import Sphere
from jaxscan.surface.albedo import GAPS, albedo, albedo_and_gaps
from tests.surface.scenes import grid, seen

SHEET = as_numpy(LightPlane.create([0.0, -0.005, 1 / 300]))


def domes() -> RangeImage:
    """Two round hills whose strength is that of albedos 0.2 and 0.8, left and right, under the law of the module."""
    x, y = grid(80, 160)
    image = replace(seen(np.maximum(8 - ((np.abs(x) - 8) ** 2 + y**2) / 8, 0.0)), sheets=(SHEET,))
    # Normals in closed form, by the gradient of the height; the camera looks along z, and height is against z.
    hill = image.points[..., 2] < 299.999
    slope_x = np.where(hill, -2 * (np.abs(x) - 8) * np.sign(x) / 8, 0.0)
    slope_y = np.where(hill, -2 * y / 8, 0.0)
    # y of the object frame runs against the frames' y.
    n = np.stack([-slope_x, slope_y, -np.ones_like(x)], axis=-1)
    n /= np.linalg.norm(n, axis=-1, keepdims=True)
    P = image.seen()
    source = laser_place(SHEET)
    to_laser = source - P
    near = np.linalg.norm(to_laser, axis=-1)
    m = SHEET.plane / np.linalg.norm(SHEET.plane)
    ray = P / np.linalg.norm(P, axis=-1, keepdims=True)
    d = np.cross(n, np.cross(ray, [0.0, 1.0, 0.0]))
    d /= np.linalg.norm(d, axis=-1, keepdims=True)
    g = np.linalg.norm(np.cross(d, ray), axis=-1) / np.abs(d @ m) / np.linalg.norm(P, axis=-1)
    true = np.where(x < 0, 0.2, 0.8)
    strength = true * np.maximum((n * to_laser).sum(axis=-1) / near, 0) * g / near
    image = replace(image, strength=(1e7 * strength).astype(np.float32))
    return image


def test_the_law_is_undone_on_slopes_of_all_directions() -> None:
    image = domes()
    found = albedo(image)
    x, y = grid(80, 160)
    for side, centre in ((-1, -8.0), (1, 8.0)):
        inside = np.isfinite(found) & (np.hypot(x - centre, y) < 6.5) & (np.sign(x) == side)
        assert inside.sum() > 900
        true = found[inside] / np.median(found[inside])
        assert np.abs(true - 1).max() < 0.06, side
        assert np.abs(true - 1).mean() < 0.012
    left, right = (np.nanmedian(found[np.hypot(x - c, y) < 6.5]) for c in (-8.0, 8.0))
    assert right / left == pytest.approx(4.0, rel=0.02)
    assert np.nanmedian(found) == pytest.approx(1.0, abs=1e-3)
    # What the strength says of one matt hill by itself: far from even.
    strength = image.strength[np.hypot(x - 8, y) < 6.5]
    assert strength.std() / strength.mean() > 0.1


def test_burnt_out_oblique_and_lonely_points_have_none() -> None:
    image = domes()
    width = np.full(image.valid.shape, 2.0, np.float32)
    width[40, 40] = np.nan
    valid = image.valid.copy()
    valid[50:53, 59:62] = False
    valid[51, 60] = True
    image = replace(image, width=width, valid=valid)
    image = replace(image, points=np.where(valid[..., None], image.points, np.nan))
    found, gaps = albedo_and_gaps(image)
    np.testing.assert_array_equal(found, albedo(image))
    assert tuple(gaps) == GAPS
    assert sum(gaps.values()) == (np.isnan(found) & valid).sum()
    # The side of the hills that is turned away from the light has none.
    assert gaps["no_strength"] == (valid & (image.strength <= 0)).sum()
    assert gaps["burnt_out"] == 1
    assert gaps["oblique"] > 0
    assert 1 <= gaps["alone"] < 50
    dim = replace(image, strength=np.where(width > 0, image.strength, np.float32(0)), valid=valid)
    assert albedo_and_gaps(dim)[1] == {**gaps, "no_strength": gaps["no_strength"] + 1, "burnt_out": 0}
    assert np.isnan(found[40, 40])
    assert np.isnan(found[51, 60])
    assert np.isnan(found[~valid]).all()
    assert np.isfinite(found[40, 42])


def test_another_place_of_the_laser() -> None:
    """One that is 60 mm aside lights the hill's sides otherwise."""
    image = domes()
    x, y = grid(80, 160)
    aside = albedo(image, laser=laser_place(SHEET) + np.array([60.0, 0.0, 0.0]))
    right, left = aside[(np.abs(x - 12) < 1) & (np.abs(y) < 2)], aside[(np.abs(x - 4) < 1) & (np.abs(y) < 2)]
    assert not np.isclose(np.nanmedian(right), np.nanmedian(left), rtol=0.05)


def test_a_light_that_is_not_known_is_refused() -> None:
    with pytest.raises(InputError, match="light in which the scan was taken is not known"):
        albedo(replace(domes(), sheets=()))


def test_rendered_balls_have_the_albedo_that_they_were_drawn_with(tmp_path) -> None:
    rig = rig_2003.simulated_rig(17)
    true = {-24.0: 0.25, 24.0: 0.7}
    balls = tuple(Body(Sphere(np.array([x, 14.0, 13.0]), 13.0), np.full(3, of)) for x, of in true.items())
    light = replace(rig_2003.SCAN_LIGHTING, ambient=20.0, directional=10.0, laser_power=700.0, laser_fan_mm=350.0)
    scene = rig_2003.scan_scene(rig, balls)
    simulate_scan(tmp_path / "scan", rig, scene, 17, frames=36, steps_apart=1000, lighting=light)
    image = reconstruct(rig, read_scan(tmp_path / "scan"))
    found = albedo(image)
    R, origin = rig_2003.platform(rig)
    x, _, z = np.moveaxis((image.points.astype(float) - origin) @ R, -1, 0)
    floor = np.nanmedian(found[z < 0.3])
    for place, of in true.items():
        ball = (z > 18) & (np.abs(x - place) < 12) & np.isfinite(found)
        assert ball.sum() > 300
        assert np.median(found[ball]) / floor == pytest.approx(of / 0.5, rel=0.05), place
        assert np.std(found[ball]) / np.mean(found[ball]) < 0.12
