"""The pipelines that ours is compared with, on a drawn world."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from benchmarks import transcription
from benchmarks.accuracy import interval
from benchmarks.drawn_2003 import FLOOR, MOVE, OMEGA, STEPS_APART, Drawing
from benchmarks.found import Found
from benchmarks.opencv_pipeline import opencv_pipeline, stripe_rows
from benchmarks.pipeline_2003 import Quirks
from benchmarks.pipelines import Taken, matlab
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings
from jaxscan.simulation.accuracy import near_its_true_point


@pytest.fixture(scope="module")
def taken(tmp_path_factory: pytest.TempPathFactory) -> tuple[Taken, Scan]:
    """Eight boards, five on the stage, three photographs of the floor."""
    folder = tmp_path_factory.mktemp("drawn")
    drawing = Drawing(folder, every=4)
    job = drawing.job(8, 5, 3)
    observations = drawing.observations(job, stripes=False)
    steps = tuple(STEPS_APART * i for i in range(3))
    scan = Scan(folder / "scan.toml", StripeSettings("red"), frames=job.scan_photos, axes={"stage": steps})
    return Taken(folder, observations, observations, observations), scan


def off_floor(found: Found, scan: int = 0) -> float:
    """RMS distance of a cloud from the floor at step 0, mm."""
    points = found.clouds[scan][np.isfinite(found.clouds[scan][..., 0])]
    return float(np.sqrt((((points @ FLOOR - 1) / np.linalg.norm(FLOOR)) ** 2).mean()))


def test_careful_opencv_finds_what_was_drawn_and_makers_do_not(taken: tuple[Taken, Scan]) -> None:
    session, scan = taken
    careful, makers = (
        opencv_pipeline(session.sub_pix, session.folder, [scan], careful=careful) for careful in (True, False)
    )
    np.testing.assert_allclose(careful.rig.lights[0].plane, OMEGA, rtol=0, atol=3e-6)
    np.testing.assert_allclose(careful.rig.axis("stage").per_step, MOVE / STEPS_APART, rtol=0, atol=3e-6)
    assert careful.clouds[0].shape == (3, 640, 3)
    assert np.isfinite(careful.clouds[0][..., 0]).mean() > 0.99
    assert careful.lit.sum(axis=1).min() > 120
    assert off_floor(careful) < 0.08
    assert off_floor(makers) > 3 * off_floor(careful)


def test_clouds_of_2003_stand_where_the_others_do(taken: tuple[Taken, Scan]) -> None:
    session, scan = taken
    put_right = Quirks(**dict.fromkeys(Quirks().as_dict(), False))
    once = matlab(put_right, transcription)(session, [scan])
    assert off_floor(once) < 0.25
    # Counted from 1, and the second of two scans: the moves are added back.
    twice = matlab(replace(put_right, index_from_one=True), transcription)(session, [scan, scan])
    for cloud in twice.clouds:
        np.testing.assert_allclose(cloud, once.clouds[0], rtol=0, atol=1e-9)
    # The drawn columns but the dark one in the middle.
    painted = np.arange(640) % 4 == 0
    painted[320] = False
    np.testing.assert_array_equal(once.lit.any(axis=0), painted)


def test_a_dark_column_has_no_stripe(tmp_path: Path) -> None:
    image = np.zeros((40, 3, 3), np.uint8)
    image[19:22, 0, 0] = [100, 200, 100]
    image[20:22, 1, 0] = 200
    np.testing.assert_allclose(stripe_rows(image, careful=True), [20, 20.5, np.nan])
    np.testing.assert_allclose(stripe_rows(image, careful=False), [20, 20, np.nan])


def test_a_cloud_that_is_off_as_a_whole_is_near_its_true_points() -> None:
    truth = np.random.default_rng(0).uniform(0, 50, (4, 50, 3))
    truth[0, 0] = np.nan
    off = truth + np.array([0.0, 0.0, 5.0])
    off[1, 1] += 40.0
    near = near_its_true_point(off, truth)
    assert near.sum() == 4 * 50 - 2
    assert not near[[0, 1], [0, 1]].any()
    assert not near_its_true_point(np.full_like(truth, np.nan), truth).any()


def test_the_interval_holds_the_median() -> None:
    values = np.random.default_rng(1).normal(3.0, 1.0, 400)
    low, high = interval(values)
    assert low < np.median(values) < high
    assert 0.1 < high - low < 0.5
