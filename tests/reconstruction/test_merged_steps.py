from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.images.exposures import merge_exposures
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.reconstruction.frames import Frames
from jaxscan.reconstruction.merged_steps import merged_steps, step_groups
from jaxscan.rig import Camera, LightPlane, Linear, Rig

STEPS, EXPOSURES = (0, 0, 10, 10, 10, 20), (0.01, 0.04, 0.01, 0.04, 0.04, 0.02)
SHAPE = (96, 64)


def scan(**other):
    return Scan(Path("scan.toml"), StripeSettings("grey"), axes={"stage": STEPS}, exposures_s=EXPOSURES, **other)


def frames():
    """A stripe that moves from step to step, exposed unequally."""
    random, v = np.random.default_rng(0), np.arange(SHAPE[0])[:, None]
    centre = 30.0 + np.linspace(0, 20, SHAPE[1]) + np.asarray(STEPS)[:, None]
    light = 400 + np.linspace(800, 20000, SHAPE[1]) * np.exp(-0.5 * ((v - centre[:, None]) / 1.3) ** 2)
    levels = np.asarray(EXPOSURES)[:, None, None] * light
    return np.rint(levels + random.standard_normal(levels.shape)).clip(0, 255).astype(np.uint8)


def batches(images, darks, size):
    for i in range(0, len(images), size):
        some = slice(i, i + size)
        yield Frames(images[some], None if darks is None else darks[some], np.asarray(STEPS[some])[:, None])


def test_steps_are_grouped_where_they_stand_together():
    assert step_groups(scan()) == [range(2), range(2, 5), range(5, 6)]
    assert [len(group) for group in step_groups(replace(scan(), exposures_s=None))] == [1] * 6
    assert step_groups(replace(scan(), axes={}, exposures_s=())) == []


def test_a_step_that_comes_again_is_refused():
    with pytest.raises(InputError, match=r"step 0 of frame 0 comes again at frame 2"):
        step_groups(replace(scan(), axes={"stage": (0, 10, 0, 10, 20, 20)}))


def test_one_background_for_several_exposures_is_refused():
    with pytest.raises(InputError, match=r"background.*one for each frame"):
        step_groups(scan(backgrounds=(Path("dark.png"),)))
    each = replace(scan(backgrounds=(Path("dark.png"),)), axes={"stage": tuple(range(6))})
    assert len(step_groups(each)) == 6


@pytest.mark.parametrize("with_dark", [False, True])
def test_what_comes_out_does_not_depend_on_the_batches_that_come_in(with_dark):
    images = frames()
    darks = np.minimum(images, 3) if with_dark else None
    whole = [
        merge_exposures(images[i:j], EXPOSURES[i:j], None if darks is None else darks[i:j])
        for i, j in ((0, 2), (2, 5), (5, 6))
    ]
    for size in (1, 4, 6):
        out = list(merged_steps(scan(), batches(images, darks, size), 2))
        assert [len(batch.positions) for batch in out] == [2, 1]
        assert np.concatenate([batch.positions for batch in out]).tolist() == [[0], [10], [20]]
        np.testing.assert_array_equal(np.concatenate([batch.images for batch in out]), np.stack([x for x, _ in whole]))
        for batch, expected in zip(out, (whole[:2], whole[2:]), strict=True):
            if darks is None:
                assert batch.backgrounds is None
            else:
                np.testing.assert_array_equal(batch.backgrounds, np.stack([dark for _, dark in expected]))


def test_a_scan_of_several_exposures_has_one_row_of_points_for_each_step(tmp_path):
    with float64():
        camera = Camera.create(SHAPE[::-1], np.array([100.0, 100.0]), np.array([31.5, 47.5]))
        stage = Linear.create(np.array([0.0, 0.01, 0.0]))
        rig = as_numpy(Rig(camera, (LightPlane.create(np.array([0.0, -0.004, 0.003])),), stage))
    paths = []
    for i, image in enumerate(frames()):
        paths.append(tmp_path / f"{i}.png")
        write_image(paths[-1], image)
    done = []
    image = reconstruct(rig, scan(frames=tuple(paths)), done.append, "gravity")
    assert sum(done) == len(STEPS)
    assert image.steps.tolist() == [0, 10, 20]
    assert image.valid.all()
    expected = 30.0 + np.linspace(0, 20, SHAPE[1]) + image.steps[:, None]
    assert np.sqrt(np.mean((image.pixels - expected) ** 2)) < 0.1
