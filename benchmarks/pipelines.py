"""The pipelines that are compared, each from the same photographs to a rig and to clouds."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from types import ModuleType
from typing import Final

import jax.numpy as jnp
import numpy as np

from benchmarks import octave, transcription
from benchmarks.found import Found
from benchmarks.laserline_rs import INSTALLED, laserline_rs
from benchmarks.opencv_pipeline import opencv_pipeline
from benchmarks.pipeline_2003 import Outcome, Quirks, job_of
from benchmarks.sub_pix import USUAL, with_sub_pix
from jaxscan.calibration import Observations, View, calibrate
from jaxscan.calibration.observe import observe
from jaxscan.files.scan import Scan
from jaxscan.files.session import Session
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.rig import Camera, LightPlane, Linear, Rig

OURS: Final = "jaxscan"
MATLAB: Final = "2003"

_STRIPE_HALF_PX = 3.0


@dataclass(frozen=True)
class Taken:
    """A session, and what was seen in it.

    Attributes:
        folder: of its photographs.
        own: corners and stripes by this project's detectors.
        with_stripe: the corners of `cornerSubPix`, which is the corner finder of Bouguet's toolbox.
        sub_pix: for everyone else: those without the corners in whose window the stripe lies, where it errs by whole
            pixels. That is kind to a pipeline that leaves nothing out by itself.
    """

    folder: Path
    own: Observations
    with_stripe: Observations
    sub_pix: Observations

    @classmethod
    def of(cls, session: Session) -> "Taken":
        """Look at the photographs."""
        folder, own = session.path.parent, observe(session)
        seen = with_sub_pix(own, folder)
        return cls(folder, own, seen, replace(seen, views=tuple(_away_from_stripe(view) for view in seen.views)))


def _away_from_stripe(view: View) -> View:
    lit = np.concatenate([np.zeros((0, 2)), *(stripe.pixels for stripe in view.stripes)])
    lit = lit[np.isfinite(lit).all(axis=1)]
    apart = np.abs(view.corners[:, None] - lit[None]).max(axis=-1)
    touched = (apart <= USUAL + _STRIPE_HALF_PX).any(axis=1)
    return replace(view, corners=np.where(touched[:, None], np.nan, view.corners))


Pipeline = Callable[[Taken, Sequence[Scan]], Found]


def ours(taken: Taken, scans: Sequence[Scan]) -> Found:
    """The joint solve, and `reconstruct`."""
    calibration = calibrate(taken.own)
    content = calibration.rig_file()
    clouds = []
    for scan in scans:
        image = reconstruct(content, scan)
        clouds.append(np.where(image.valid[..., None], image.points.astype(np.float64), np.nan))
    columns = taken.own.image_size[0]
    lit = np.zeros((len(taken.own.views), columns), bool)
    for mask, view in zip(lit, taken.own.views, strict=True):
        for stripe in view.stripes:
            mask[np.flatnonzero(np.isfinite(stripe.pixels[:, 1]))] = True
    return Found(calibration.rig, tuple(clouds), lit)


def matlab(quirks: Quirks | None = None, runner: ModuleType | None = None) -> Pipeline:
    """The pipeline of 2003, in Octave where it is installed and no other runner is named.

    Photographs of a scan are counted from 1 in it, so that its cloud stands one stage move from the first photograph's
    frame: that move is added here.
    """
    quirks = quirks or Quirks(loops=False)
    runner = runner or (octave if octave.octave() else transcription)

    def pipeline(taken: Taken, scans: Sequence[Scan]) -> Found:
        spacings = {
            int(n)
            for steps in (taken.own.sequences[0].steps, *(s.axes["stage"] for s in scans))
            for n in np.diff(steps)
        }
        if len(spacings) != 1:
            raise ValueError(f"the pipeline of 2003 moves each photograph by the same: steps apart are {spacings}")
        frames = tuple(frame for scan in scans for frame in scan.frames)
        job = replace(job_of(taken.sub_pix, taken.folder, None), scan_photos=frames)
        outcome = runner.run(job, quirks)
        grid = outcome.organised(len(frames), taken.own.image_size[0])
        clouds, before = [], 0
        for scan in scans:
            index = before + (1 if quirks.index_from_one else 0)
            clouds.append(grid[before : before + len(scan.frames)] + index * outcome.stage_move)
            before += len(scan.frames)
        return Found(
            _rig(outcome, taken.own.image_size, spacings.pop()),
            tuple(clouds),
            _lit(outcome, quirks, taken.own),
        )

    return pipeline


def _rig(outcome: Outcome, image_size: tuple[int, int], steps_apart: int) -> Rig:
    with float64():
        camera = Camera.create(image_size, outcome.focal, outcome.principal, "radial1", np.array([outcome.k1]))
        stage = Linear.create(jnp.asarray(outcome.stage_move / steps_apart))
        return as_numpy(Rig(camera, (LightPlane.create(outcome.laser_plane),), stage))


def _lit(outcome: Outcome, quirks: Quirks, observations: Observations) -> np.ndarray:
    lit = np.zeros((len(observations.views), observations.image_size[0]), bool)
    view, column = outcome.board_stripes[:, :2].astype(int).T
    lit[view - 1, column - (1 if quirks.pixels_from_one else 0)] = True
    return lit


def sequential_opencv(taken: Taken, scans: Sequence[Scan]) -> Found:
    """Careful, one thing after the other."""
    return opencv_pipeline(taken.sub_pix, taken.folder, scans, careful=True)


def makers(taken: Taken, scans: Sequence[Scan]) -> Found:
    """The usual maker's recipe."""
    return opencv_pipeline(taken.sub_pix, taken.folder, scans, careful=False)


def calibration_rs(taken: Taken, scans: Sequence[Scan]) -> Found:
    """Camera and light plane jointly, by calibration-rs."""
    return laserline_rs(taken.sub_pix, taken.folder, scans)


PIPELINES: Final[dict[str, Pipeline]] = {
    MATLAB: matlab(),
    "makers": makers,
    "opencv": sequential_opencv,
    **({"calibration-rs": calibration_rs} if INSTALLED else {}),
    OURS: ours,
}
