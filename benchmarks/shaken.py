"""Boards that a hand holds: smeared corners, and boards that move between the photographs of corners and stripe.

The boards are those of the simulated rig of 2003; how far each moves and turns is `Hand`'s. Smeared corners are those
of rendered photographs, against the mean pose. Of boards that move between two photographs corners and stripes are
drawn, with a noise of 0.007 px and 0.058 px, for a session is solved in seconds then.
"""

from dataclasses import replace
from typing import Final

import jax
import jax.numpy as jnp
import numpy as np

from benchmarks.drawn import Noise, exact_session, exact_views, redrawn
from benchmarks.metric import Metric
from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics import diagnose
from jaxscan.geometry import Pose
from jaxscan.images import find_board
from jaxscan.precision import as_float64, float64
from jaxscan.simulation import rig_2003
from jaxscan.simulation.hand import Hand
from jaxscan.simulation.render import render
from jaxscan.view.model_findings import model_findings

_NOISE: Final = Noise(corner=0.007, stripe=0.058)
_PX_PER_MM: Final = 2.2


def smeared(quick: bool) -> list[Metric]:
    """Errors of corners of boards that move while they are photographed, in px and in their σ."""
    print("  boards in a hand, corners: RMS error px, median σ px, RMS error in σ, corners found")
    rig, metrics = rig_2003.simulated_rig(0), []
    lighting = replace(rig_2003.BOARD_LIGHTING, speckle=rig_2003.SPECKLE)
    poses, points = rig_2003.board_poses(rig, 0), rig_2003.BOARD.points()
    for shake_mm in (0.0, 1.0) if quick else (0.0, 0.1, 0.3, 1.0, 3.0):
        errors, sigmas = [], []
        for i in range(2 if quick else rig_2003.BOARD_VIEWS):
            pose = Pose(np.asarray(poses.rotation[i]), np.asarray(poses.translation[i]))
            scenes = rig_2003.held(rig, Hand(shake_mm), pose, (0, i), 1)[0]
            found = find_board(rig_2003.BOARD, render(rig, scenes, laser=0, lighting=lighting, seed=(0, i)))
            if found is None or found.sigma is None:
                continue
            with float64():
                seen = np.asarray(jax.vmap(as_float64(rig.camera).project)(jnp.asarray(pose.apply(points))))
            kept = np.isfinite(found.sigma)
            errors.append((found.corners - seen)[kept])
            sigmas.append(found.sigma[kept])
        error, sigma = np.concatenate(errors), np.concatenate(sigmas)
        rms, in_sigma = float(np.sqrt((error**2).mean())), float(np.sqrt(((error / sigma[:, None]) ** 2).mean()))
        print(f"    {shake_mm:g} mm: {rms:.4f} {np.median(sigma):.4f} {in_sigma:.2f} {len(sigma)}", flush=True)
        name = f"bad_light.smeared_{shake_mm:g}_mm"
        metrics += [Metric(f"{name}.corner_rms", rms, "px"), Metric(f"{name}.in_sigma", in_sigma)]
    return metrics


def moved(quick: bool) -> list[Metric]:
    """Errors of rigs in their σ where the board moved between corners and stripe, and in how many this is said."""
    print("  boards in a hand, corners and stripe apart: RMS error of the rig in σ, of the plane; stripe σ px; said")
    metrics = []
    for shake_mm in (0.0, 0.3) if quick else (0.0, 0.05, 0.1, 0.3, 1.0):
        squares, stripe_sigmas, said = [], [], []
        for seed in range(2 if quick else 10):
            rig, exact = exact_session(seed)
            views = exact_views(rig, _one_exposure_on(rig_2003.board_poses(rig, seed), Hand(shake_mm), seed))
            apart = (replace(view, stripes=later.stripes) for view, later in zip(exact.views, views, strict=True))
            observed = redrawn(replace(exact, views=tuple(apart)), _NOISE, np.random.default_rng([seed, 7]))
            calibration = calibrate(observed)
            found, true = (np.array([float(x) for x in jax.tree.leaves(each)]) for each in (calibration.rig, rig))
            error = found - true
            plane = [i for i, name in enumerate(calibration.covariance.names) if name.startswith("lights")]
            squares.append(
                [
                    error[at] @ np.linalg.solve(calibration.covariance.matrix[np.ix_(at, at)], error[at]) / len(at)
                    for at in (list(range(len(error))), plane)
                ]
            )
            stripe_sigmas.append(calibration.stripe_sigma_px)
            boxes = model_findings(calibration, diagnose(calibration, thorough=False))
            said.append(any("fit no plane" in box.statement for box in boxes))
        of_rig, of_plane = (float(x) for x in np.sqrt(np.mean(squares, axis=0)))
        share = float(np.mean(said))
        print(f"    {shake_mm:g} mm: {of_rig:.2f} {of_plane:.2f} {np.mean(stripe_sigmas):.3f} {share:.2f}", flush=True)
        name = f"bad_light.moved_{shake_mm:g}_mm"
        goal = ("lower", 0.0) if not shake_mm else ("higher", 1.0) if shake_mm >= 0.3 else ("shown", None)
        metrics += [
            Metric(f"{name}.rig_in_sigma", of_rig),
            Metric(f"{name}.plane_in_sigma", of_plane),
            Metric(f"{name}.said", share, "", *goal),
        ]
    return metrics


def _one_exposure_on(poses: Pose, hand: Hand, seed: int) -> Pose:
    """The mean poses of boards over the exposure after the one that shows them in these."""
    later = []
    for i, (rotation, translation) in enumerate(
        zip(np.asarray(poses.rotation), np.asarray(poses.translation), strict=True)
    ):
        pose = Pose(rotation, translation)
        moments = hand.held(pose, rig_2003.BOARD.points(), (2003, seed, 5, i), 2, _PX_PER_MM)[1]
        later.append(moments[len(moments) // 2])
    return Pose(*(np.stack([np.asarray(getattr(p, part)) for p in later]) for part in ("rotation", "translation")))
