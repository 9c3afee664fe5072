"""A figure scanned once all around while it turns, rendered with speckle of contrast 0.3.

The rig comes from a rendered session with a board on the table; the same photographs of the figure are reconstructed
with it and with the true rig. The makers' recipe beside it: camera from OpenCV's way of calibrating, the light plane by
total least squares, the axis from the circle of the board's middle, the angle of a step as the motor has it, and the
mean of each line's bright pixels.

A second rig has two lasers, a photograph by each at every angle: the points of the one are held against the surface of
the other, both by the calibrated rig. Of each point and the nearest of the other laser, neither on a rim, the distance
along the mean normal is divided by the σ of the two pixels along it; what the rig is wrong by is not in that σ.
"""

import tempfile
from dataclasses import replace
from pathlib import Path
from typing import Final

import numpy as np
from jaxtyping import Float

from benchmarks.metric import Metric
from benchmarks.sequential import sequential
from jaxscan.calibration import Observations, calibrate
from jaxscan.calibration.first_poses import poses_of_photographs
from jaxscan.calibration.observe import observe
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session
from jaxscan.geometry import Pose
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import RangeImage, reconstruct
from jaxscan.rig import Rig, Rotary, motion_of
from jaxscan.simulation import Scene, distance, rig_2003
from jaxscan.simulation.accuracy import rigid_fit
from jaxscan.simulation.folders import ScanTruth, simulate_scan, simulate_session
from jaxscan.simulation.shapes import figure
from jaxscan.surface.clean import clean
from jaxscan.surface.fused import fused
from jaxscan.surface.pairs import equations, match
from jaxscan.surface.side import side_of_image

_SPECKLE: Final = 0.3
# Motor steps from frame to frame: 356 frames of a turn, and 100 in the quick form.
_APART, _APART_QUICK = 9, 32
# Photographs of the board on the turntable: the motor takes them by itself.
_TURNTABLE_VIEWS: Final = 64


def measure(quick: bool) -> list[Metric]:
    """Rendered, calibrated, reconstructed; one seed, or four."""
    each = [[*_measured(seed, quick), *_of_two_lasers(seed, quick)] for seed in range(1 if quick else 4)]
    return [
        replace(metrics[0], value=float(np.sqrt(np.mean([metric.value**2 for metric in metrics]))))
        for metrics in zip(*each, strict=True)
    ]


def _measured(seed: int, quick: bool) -> list[Metric]:
    true = rig_2003.with_turntable(rig_2003.simulated_rig(seed), seed)
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        speckled = {"speckle": _SPECKLE}
        boards = replace(rig_2003.BOARD_LIGHTING, **speckled)
        simulate_session(here / "session", seed, rig=true, lighting=boards, turntable_views=_TURNTABLE_VIEWS)
        observations = observe(read_session(here / "session"))
        found = calibrate(observations)
        axes = rig_2003.turning_axes(_APART_QUICK if quick else _APART)
        scene = rig_2003.scan_scene(true, figure(rig_2003.OBJECT_Y))
        light = replace(rig_2003.SCAN_LIGHTING, **speckled)
        truth = simulate_scan(here / "scan", true, scene, seed, axes=axes, lighting=light)
        scan = read_scan(here / "scan")
        own = reconstruct(found.rig_file(), scan)
        exact = reconstruct(true, scan)
        makers = reconstruct(_makers(observations), scan, detector="threshold")
    both = own.valid & exact.valid
    placed, true_place = (image.points[both].astype(np.float64) for image in (own, exact))
    shift = placed - true_place
    # Without where the object stands before the camera, which no measure of its surface knows.
    bent = rigid_fit(placed, true_place).apply(placed) - true_place
    error, least, recipe = (_off(image, truth) for image in (own, exact, makers))
    first, last = _seam(own, truth)
    return [
        Metric("turning.rms_over_true_rig", _rms(error) / _rms(least), "", "lower", 1.1),
        Metric("turning.rms", _rms(error), "mm", "lower"),
        Metric("turning.part_of_rig_and_motion", _rms(np.linalg.norm(shift, axis=1)), "mm", "lower", 0.015, slack=0.2),
        Metric("turning.part_of_rig_in_shape", _rms(np.linalg.norm(bent, axis=1)), "mm", "lower", 0.015, slack=0.2),
        Metric("turning.first_frame_against_last", abs(first - last), "mm", "lower", 0.02, slack=0.5),
        Metric("turning.over_makers", _rms(error) / _rms(recipe), "", "lower", 0.25, slack=0.1),
        *_within(own, truth),
        *_vertices_within(own, scene),
    ]


def _of_two_lasers(seed: int, quick: bool) -> list[Metric]:
    """The points of one laser against the surface of the other, of a rig with two."""
    true = rig_2003.with_turntable(rig_2003.simulated_rig(seed, 2), seed)
    axes = rig_2003.turning_axes(_APART_QUICK if quick else _APART)
    scene = rig_2003.scan_scene(true, figure(rig_2003.OBJECT_Y))
    light = replace(rig_2003.SCAN_LIGHTING, speckle=_SPECKLE)
    sides = []
    with tempfile.TemporaryDirectory() as folder:
        here = Path(folder)
        boards = replace(rig_2003.BOARD_LIGHTING, speckle=_SPECKLE)
        simulate_session(here / "session", seed, rig=true, lighting=boards, turntable_views=_TURNTABLE_VIEWS)
        found = calibrate(observe(read_session(here / "session"))).rig_file()
        for i, laser in enumerate(true.lights):
            simulate_scan(here / laser.name, true, scene, seed, laser=i, axes=axes, lighting=light)
            sides.append(side_of_image(laser.name, reconstruct(found, read_scan(here / laser.name))))
    still, spacing = Pose.identity(), max(side.spacing_mm for side in sides)
    upper, lower = sides
    matches = match(upper, lower, still, still, spacing, max(len(side.points) for side in sides))
    pairs = equations(upper, lower, still, still, matches, np.zeros(3))
    return [
        Metric("turning.lasers_apart_in_sigma", _rms(pairs.residual / pairs.sigma), "", "lower", 1.25),
        Metric("turning.lasers_apart", _rms(pairs.residual), "mm", "lower"),
    ]


def _off(image: RangeImage, truth: ScanTruth) -> Float[np.ndarray, "points"]:
    """From the true point of the same frame and column, mm; those further than 2 mm off are other surfaces' points."""
    both = image.valid & np.isfinite(truth.points[..., 0])
    off = np.linalg.norm(image.points[both] - truth.points[both], axis=1)
    return off[off < 2.0]


def _seam(image: RangeImage, truth: ScanTruth) -> tuple[float, float]:
    """The mean error towards the camera of the first frame and of the last, mm."""
    back = image.from_camera().matrix()[:, :, 2]
    error = np.einsum("fci,fi->fc", image.points.astype(np.float64) - truth.points, back)
    error[~image.valid] = np.nan
    error[np.abs(error) > 1.0] = np.nan
    return float(np.nanmean(error[0])), float(np.nanmean(error[-1]))


def _within(image: RangeImage, truth: ScanTruth) -> list[Metric]:
    """The part of the points within 1, 2 and 3 σ along their rays."""
    rays = image.points.astype(np.float64) - image.cameras()[:, None]
    rays /= np.linalg.norm(rays, axis=-1, keepdims=True)
    off = ((image.points - truth.points) * rays).sum(axis=-1) / image.sigma
    off = np.abs(off[image.valid & np.isfinite(off)])
    return [Metric(f"turning.within_{k}_sigma", float((off <= k).mean())) for k in (1, 2, 3)]


def _vertices_within(image: RangeImage, scene: Scene) -> list[Metric]:
    """The part of the fused surface's vertices within 1, 2 and 3 σ of the true one; and how far passages disagree."""
    found = fused(clean(image).image)
    vertices = np.asarray(found.mesh.vertices)
    off = distance(scene, vertices) / found.sigma
    return [
        *(Metric(f"turning.vertices_within_{k}_sigma", float((off <= k).mean())) for k in (1, 2, 3)),
        Metric("turning.passages_disagree", found.disagreement or 1.0),
    ]


def _makers(observations: Observations) -> Rig:
    """The rig of the makers' recipe."""
    with float64():
        rig = sequential(observations)
        poses = poses_of_photographs(observations, rig.camera, np.zeros((len(observations.views), 6)))
    (turn,) = (sequence for sequence in observations.sequences if sequence.axis == "turntable")
    middles = poses.apply(observations.board.points().mean(axis=0)[None])[-len(turn.views) :, 0]
    stood = np.asarray(turn.positions["stage"], np.float64)
    middles = middles - rig.pose({"stage": stood}).translation
    centre, axis = _circle(middles)
    # The motor's own angle, with the sign that the board shows.
    spin = np.cross(middles[0] - centre, middles[1] - centre) @ axis
    turntable = Rotary.create(np.sign(spin) * axis * 2 * np.pi / rig_2003.STEPS_PER_TURN, centre)
    return as_numpy(Rig(rig.camera, rig.lights, motion_of((*rig.motion.parts(), turntable))))


def _circle(points: Float[np.ndarray, "points 3"]) -> tuple[Float[np.ndarray, "3"], Float[np.ndarray, "3"]]:
    """Centre and axis of the circle through points: their plane, and a circle in it by algebraic least squares."""
    middle = points.mean(axis=0)
    across = np.linalg.svd(points - middle)[2]
    x, y = ((points - middle) @ across[:2].T).T
    a, b, _ = np.linalg.lstsq(np.stack([2 * x, 2 * y, np.ones_like(x)], axis=1), x**2 + y**2, rcond=None)[0]
    return middle + a * across[0] + b * across[1], across[2]


def _rms(values: Float[np.ndarray, "values"]) -> float:
    return float(np.sqrt(np.mean(values**2)))
