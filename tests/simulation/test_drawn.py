"""Drawn scans against the truth and their own σ."""

import numpy as np

from jaxscan.simulation import distance, rig_2003
from jaxscan.simulation.drawn import drawn_scan
from jaxscan.simulation.shapes import sphere


def test_points_scatter_about_the_surface_by_their_sigma():
    rig = rig_2003.simulated_rig(0)
    scene = rig_2003.scan_scene(rig, (sphere(rig_2003.OBJECT_Y),))
    scan = drawn_scan(rig, scene, {"stage": np.array([26_000, 40_000])}, 0.05)
    image = scan.image
    assert image.valid.sum() > 500
    np.testing.assert_array_equal(image.valid, np.isfinite(scan.points).all(axis=-1))
    assert distance(scene, scan.points[image.valid]).max() < 1e-5
    ray = image.points - image.cameras()[:, None]
    ray /= np.linalg.norm(ray, axis=-1, keepdims=True)
    along = ((image.points - scan.points) * ray).sum(axis=-1)[image.valid]
    assert abs(np.std(along / image.sigma_pixel[image.valid]) - 1) < 0.1
    pixels = (image.pixels - scan.position)[image.valid]
    assert abs(pixels.std() / 0.05 - 1) < 0.1
