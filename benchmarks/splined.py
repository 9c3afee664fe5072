"""A splined lens on photographs through lenses that no formula has: rays, points, σ, and its cost.

Sessions of 16 boards that fill the image, drawn with normal noise of 0.05 px for corners and 0.1 px for stripes. Of the
lens 0.5 px RMS along each axis are a random field of wavelengths about a third of the image; or 2 px a dent of 50 px;
or nothing. Rays are compared all over the image, and points where they meet the sheet, both with the turn about the
camera's centre taken out that fits them best. What could be known is Brown's lens on the same boards without the field.
"""

import time
from collections.abc import Sequence
from dataclasses import replace
from typing import Final

import jax
import numpy as np
from jaxtyping import Float

from benchmarks.drawn_fields import IMAGE_SIZE, Field, camera_of, rays_of, session_through
from benchmarks.metric import Metric
from benchmarks.throughput import power_of_ten, random_pixels, triangulation
from benchmarks.timing import side_by_side
from jaxscan.calibration import Calibration, Observations, calibrate
from jaxscan.calibration.lens_field import with_field
from jaxscan.errors import ObservabilityError, SolveError
from jaxscan.precision import as_float64, as_numpy, float64
from jaxscan.rig import Rig
from jaxscan.rig.covariance import projection_jacobian
from jaxscan.rig.projection import pixel_rays, project_points
from jaxscan.rig.spline import basis
from jaxscan.rig.splined import CELLS, Splined

_SEEDS, _COVERED = 3, 12
_LENSES: Final = ("brown", "rational", "splined")
_PIXELS: Final = np.stack(
    np.meshgrid(np.linspace(5, IMAGE_SIZE[0] - 6, 22), np.linspace(5, IMAGE_SIZE[1] - 6, 17)), axis=-1
).reshape(-1, 2)
_FOCAL: Final = 694.0
_DEPTHS_MM: Final = (200.0, 500.0)
_SHIFT_PX: Final = 0.5
_NONE: Final = Field.random(0, 0.0)


def measure(quick: bool) -> list[Metric]:
    """Three sessions of each lens and twelve for σ; or one of a field alone."""
    camera = camera_of()
    kinds = {"field": lambda seed: Field.random(seed, 0.5)}
    if not quick:
        kinds |= {"dent": lambda seed: Field.of_dent(seed, 2.0), "formula": lambda seed: _NONE}
    metrics, took = [], {}
    for name, field_of in kinds.items():
        found = {lens: [] for lens in ("known", *(("brown", "splined") if quick else _LENSES))}
        for seed in range(1 if quick else _SEEDS):
            for lens, errors in found.items():
                field = _NONE if lens == "known" else field_of(seed)
                rig, seen = session_through(camera, field, seed)
                begin = time.perf_counter()
                solved = _calibrated(seen, "brown" if lens == "known" else lens)
                took.setdefault(lens, []).append(time.perf_counter() - begin)
                if solved is not None:
                    errors.append(_errors(solved, rig, rays_of(camera, field, _PIXELS)))
        for lens, errors in found.items():
            if errors:
                rays, points = np.sqrt(np.mean(np.square(errors), axis=0))
                metrics.append(Metric(f"splined.{name}.{lens}.rays_px", float(rays), "px"))
                metrics.append(Metric(f"splined.{name}.{lens}.points_mm", float(points), "mm"))
                print(f"  {name} {lens}: {len(errors)} solved, {rays:.4f} px, {points:.4f} mm", flush=True)
        known, own = (np.sqrt(np.mean(np.square(found[lens]), axis=0)) for lens in ("known", "splined"))
        goal = 1.05 if name == "formula" else 2.0
        over = float(own[0] / known[0])
        metrics.append(Metric(f"splined.{name}.rays_over_known", over, "", "lower", goal, slack=0.1))
    if not quick:
        metrics += covered(range(_COVERED), 1 / 3, "third") + covered(range(_COVERED), 1 / 2, "half")
        ratio = float(np.median(took["splined"]) / np.median(took["brown"]))
        metrics.append(Metric("splined.time_over_brown", ratio))
    return [*metrics, *_kernel(quick)]


def covered(seeds: Sequence[int], share: float, name: str) -> list[Metric]:
    """The share of rays within 1, 2 and 3 σ, of sessions of corners alone; 0.683, 0.954 and 0.997 are normal.

    Rays of one session err together: that of most σ is a scale of the image.

    Args:
        seeds: of the sessions.
        share: of the image, the wavelength of the field.
        name: of the metrics.
    """
    camera, z = camera_of(), []
    for seed in seeds:
        field = Field.random(seed, 0.5, share)
        _, seen = session_through(camera, field, seed, laser=False)
        solved = _calibrated(seen, "splined")
        if solved is not None:
            z.append(in_sigma(solved, rays_of(camera, field, _PIXELS)))
            within = ", ".join(f"{(np.abs(z[-1]) < k).mean():.3f}" for k in (1, 2, 3))
            print(f"  {seed}: {within}; {_prior_of(solved)}", flush=True)
    every = np.abs(np.concatenate(z))
    goals = {1: 0.6, 2: 0.9, 3: 0.98}
    return [
        Metric(f"splined.{name}.within_{k}_sigma", float((every < k).mean()), "", "higher", goal, slack=0.05)
        for k, goal in goals.items()
    ]


def _prior_of(found: Calibration) -> str:
    """What was taken to be known of the field."""
    field = found.adjustment.noise.field
    assert field is not None
    return f"prior {float(field.sigma) * _FOCAL:.2f} px, {float(field.reach):g} cells"


def in_sigma(found: Calibration, true: Float[np.ndarray, "rays 3"]) -> Float[np.ndarray, "coordinates"]:
    """How far the pixels of true rays, turned to the camera's frame, are from where they are, in σ.

    What a turn does is taken out of both.
    """
    turned = true @ _turn(pixel_rays(found.rig.camera, _PIXELS), true).T
    seen = project_points(found.rig.camera, turned)
    turns = np.stack([np.cross(axis, turned) for axis in np.eye(3)], axis=-1)
    Q = np.linalg.qr((seen.by_point @ turns).reshape(-1, 3))[0]
    J = projection_jacobian(found.rig, turned).reshape(len(Q), -1)
    J, off = J - Q @ (Q.T @ J), (seen.pixels - _PIXELS).ravel()
    variance = np.einsum("ri,ij,rj->r", J, found.covariance.of_leaves(found.rig), J, optimize=True)
    return (off - Q @ (Q.T @ off)) / np.sqrt(variance)


def _kernel(quick: bool) -> list[Metric]:
    """The kernel's rate over that of Brown's lens."""
    camera, metrics = camera_of(), []
    with float64():
        splined = with_field(as_float64(camera))
        lens = splined.lens
        assert isinstance(lens, Splined)
        # A random field as a spline over the image.
        focal, principal = np.stack(camera.focal), np.stack(camera.principal)
        shifts = (Field.random(0, _SHIFT_PX).moved(_PIXELS) - _PIXELS) / focal
        weights = basis(np.stack(lens.extent), CELLS, (_PIXELS - principal) / focal)
        x, y = np.linalg.lstsq(weights, shifts)[0].T
        splined = as_numpy(replace(splined, lens=replace(lens, shift_x=tuple(x), shift_y=tuple(y))))
    for count in (10**6,) if quick else (10**6, 10**7):
        pixels = random_pixels(count, "float32")
        brown, own = (triangulation(pixels, "brown", camera=each) for each in (camera, splined))
        brown()
        own()
        plain, took = side_by_side(brown, own, 15)
        name = f"splined.kernel.{power_of_ten(count)}"
        print(f"  {name}: {took / count * 1e9:.2f} ns a point; brown {plain / count * 1e9:.2f}", flush=True)
        metrics.append(Metric(name, plain / took, "of brown", "higher", slack=1.0))
    return metrics


def _calibrated(seen: Observations, lens: str) -> Calibration | None:
    """None where the photographs do not determine the lens."""
    try:
        return calibrate(seen, lens=lens)
    except (ObservabilityError, SolveError) as error:
        print(f"  {lens}: {error}", flush=True)
        return None


def _errors(found: Calibration, rig: Rig, true: Float[np.ndarray, "rays 3"]) -> tuple[float, float]:
    """RMS along each axis of rays, pixels, and RMS of points of the sheet, mm."""
    own = pixel_rays(found.rig.camera, _PIXELS)
    turn = _turn(own, true)
    back = own @ turn
    rays = _FOCAL * (back / back[:, 2:] - true)[:, :2]
    points, truth = (
        x / (x @ np.array([float(leaf) for leaf in jax.tree.leaves(each.lights[0])]))[:, None]
        for x, each in ((own, found.rig), (true, rig))
    )
    there = (truth[:, 2] > _DEPTHS_MM[0]) & (truth[:, 2] < _DEPTHS_MM[1])
    off = (points @ turn - truth)[there]
    return float(np.sqrt((rays**2).mean())), float(np.sqrt((off**2).sum(axis=1).mean()))


def _turn(own: Float[np.ndarray, "rays 3"], true: Float[np.ndarray, "rays 3"]) -> Float[np.ndarray, "3 3"]:
    """The rotation R that takes true rays nearest to the others: own ≈ R true (W. Kabsch 1976)."""
    a, b = (x / np.linalg.norm(x, axis=1, keepdims=True) for x in (own, true))
    U, _, Vt = np.linalg.svd(a.T @ b)
    return U @ np.diag([1.0, 1.0, np.linalg.det(U @ Vt)]) @ Vt
