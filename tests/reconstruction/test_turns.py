"""What looks at a frame's neighbours in time looks over the ends of a full turn."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from jaxscan.files.scan import Scan
from jaxscan.images import StripeSettings, write_image
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import reconstruct
from jaxscan.reconstruction.turns import with_ends
from jaxscan.rig import Rig, Rotary
from tests.reconstruction.small import small_rig, wavy_stripe

FRAMES, APART = 120, 10
GREY = StripeSettings(color="grey")


@pytest.fixture(scope="module")
def rig() -> Rig:
    """With a turntable of 1200 steps a turn, its axis through what is seen and across the stripe."""
    small = small_rig()
    with float64():
        turntable = Rotary.create(2 * np.pi / (FRAMES * APART) * np.array([0.0, 0.6, 0.8]), [0.0, 10.0, 300.0])
        return as_numpy(Rig(small.camera, small.lights, turntable))


@pytest.fixture(scope="module")
def scan(tmp_path_factory) -> Scan:
    folder = tmp_path_factory.mktemp("turn")
    paths = [folder / f"{i:03d}.png" for i in range(FRAMES)]
    for i, path in enumerate(paths):
        noise = np.random.default_rng(i).normal(size=wavy_stripe(0.0).shape)
        write_image(path, (wavy_stripe(6 * np.sin(2 * np.pi * i / FRAMES)) + noise).clip(0, 255).astype(np.uint8))
    steps = tuple(range(0, FRAMES * APART, APART))
    return Scan(folder / "scan.toml", GREY, tuple(paths), axes={"turntable": steps})


def begun_at(scan: Scan, first: int, around: int) -> Scan:
    """Its positions go on behind a full turn, or start again at 0."""
    steps = np.roll(scan.axes["turntable"], -first) + np.where(np.arange(FRAMES) < FRAMES - first, 0, around)
    frames = tuple(np.roll(np.array(scan.frames, object), -first))
    return replace(scan, frames=frames, axes={"turntable": tuple(int(step) for step in steps)})


def test_a_turn_goes_on_before_its_first_frame_and_behind_its_last(rig, scan):
    longer, before = with_ends(scan, rig.motion, 3)
    assert before == 3
    assert longer.frames == (*scan.frames[-3:], *scan.frames, *scan.frames[:3])
    assert longer.axes["turntable"] == tuple(range(-3 * APART, (FRAMES + 3) * APART, APART))
    twice = replace(
        scan,
        frames=tuple(Path(f"{i}.png") for i in range(2 * FRAMES)),
        axes={"turntable": tuple(np.repeat(scan.axes["turntable"], 2).tolist())},
        exposures_s=(0.01, 0.04) * FRAMES,
        backgrounds=tuple(Path(f"dark{i}.png") for i in range(2 * FRAMES)),
    )
    longer, before = with_ends(twice, rig.motion, 3)
    assert before == 3
    assert longer.frames[:7] == (*twice.frames[-6:], twice.frames[0])
    assert longer.backgrounds[-6:] == twice.backgrounds[:6]
    assert len(longer.exposures_s or ()) == 2 * FRAMES + 12
    assert with_ends(scan, small_rig().motion, 3) == (scan, 0)
    assert with_ends(scan, rig.motion, 0) == (scan, 0)
    part = replace(scan, frames=scan.frames[:-9], axes={"turntable": scan.axes["turntable"][:-9]})
    assert with_ends(part, rig.motion, 3) == (part, 0)
    uneven = replace(scan, axes={"turntable": (*scan.axes["turntable"][:-1], FRAMES * APART - 12)})
    assert with_ends(uneven, rig.motion, 3)[1] == 3
    assert with_ends(uneven, rig.motion, 3, equal=True) == (uneven, 0)


@pytest.mark.parametrize("around", [FRAMES * APART, 0])
@pytest.mark.parametrize("how", [{"spacetime": True}, {"choice": "coherent"}])
def test_points_do_not_depend_on_which_frame_comes_first(rig, scan, how, around):
    one = reconstruct(rig, scan, detector="gravity", **how)
    other = reconstruct(rig, begun_at(scan, 37, around), detector="gravity", **how)
    assert one.valid.shape == other.valid.shape
    assert len(one.valid) == FRAMES
    assert one.valid[[0, -1]].any(axis=1).all()
    np.testing.assert_array_equal(np.roll(one.valid, -37, axis=0), other.valid)
    apart = np.linalg.norm(np.roll(one.points, -37, axis=0) - other.points, axis=-1)[other.valid]
    # In single precision a search for a centre ends a little elsewhere now and then.
    assert np.percentile(apart, 99) < 2e-3
    assert apart.max() < 0.05
    assert len(other.gaps()) == FRAMES
