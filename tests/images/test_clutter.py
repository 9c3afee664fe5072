"""Photographs with more in them than a stripe, and stripes in weak light: what is taken, what is left, and why."""

from dataclasses import fields
from types import SimpleNamespace

import numpy as np
import pytest

from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.detectors import Measured
from jaxscan.images.stripes.faint import faint_runs
from jaxscan.images.stripes.validity import LN_WIDTHS, Verdict, in_a_line

ROWS, COLUMNS = 480, 640
RED, GREY = StripeSettings("red"), StripeSettings("grey")
U, V = np.arange(COLUMNS), np.arange(ROWS)[:, None]
# A step of depth, and a gap.
CENTRE = 250 + 30 * np.sin(U / 90) + 45 * ((U > 180) & (U < 300))
GAP = (U >= 380) & (U < 420)


def line(centre, height, s=1.5, seed=0, contrast=0.2):
    speckle = np.random.default_rng(seed).gamma(contrast**-2, contrast**2, (ROWS, COLUMNS))
    return height * np.exp(-0.5 * ((V - centre) / s) ** 2) * speckle


def blob(column, row, s, peak):
    return peak * np.exp(-0.5 * ((U - column) ** 2 + (V - row) ** 2) / s**2)


def photograph(red, white=0.0, seed=1, noise=2.0):
    light = np.repeat((40 + white + 0 * red)[..., None], 3, axis=2) + red[..., None] * (1.0, 0.06, 0.04)
    light = light + noise * np.random.default_rng(seed).standard_normal(light.shape)
    return np.rint(light).clip(0, 255).astype(np.uint8)


STRIPE = line(CENTRE, 160 * np.where(U < 500, 1.0, 0.35) * ~GAP)
GHOST = line(CENTRE - 80, 56, seed=2)
LAMP = 500 / (1 + np.exp(np.hypot(U - 100, V - 330) - 22)) + blob(100, 330, 45, 60)
CLUTTER = {
    "a ghost": (GHOST, 0.0),
    "a crossing ghost": (line(120 + 0.3 * U, 56, seed=3), 0.0),
    "a mirror image": (np.where((U > 300) & (U < 460), line(620 - CENTRE, 80, seed=4), 0.0), 0.0),
    "a lamp": (LAMP, 0.0),
    "a highlight": (0.0, blob(350, 120, 7, 1500)),
    "a long highlight": (0.0, 900 * np.exp(-0.5 * (((U - 450) / 40) ** 2 + ((V - 100 - 0.4 * (U - 450)) / 2) ** 2))),
    "a window": (0.0, 300.0 * ((V < 60 + 0.05 * U) & (U > 200) & (U < 450))),
    "all": (GHOST + LAMP, blob(350, 120, 7, 1500)),
}


@pytest.mark.parametrize("name", CLUTTER)
def test_clutter_is_no_stripe_and_the_stripe_is_kept(name):
    red, white = CLUTTER[name]
    found = detect_stripe(photograph(STRIPE + red, white), RED)
    off = np.abs(found.position[0] - CENTRE)
    strays = found.valid[0] & (GAP | ~(off < 3))
    over = np.abs(CENTRE - (120 + 0.3 * U)) < 8 if name == "a crossing ghost" else np.zeros(COLUMNS, bool)
    kept = (found.valid[0] & (off < 3))[~GAP & ~over]
    assert strays.sum() <= 0.002 * COLUMNS, np.flatnonzero(strays)
    assert kept.mean() > 0.975


@pytest.mark.parametrize("white", [12.0, 20.0, 40.0])
def test_a_small_white_thing_where_no_stripe_is_seen_is_none(white):
    """It is brighter than most of the frame: in a turn a white panda's head had points, 20 mm off."""
    small = white * ((np.abs(U - 400) < 14) & (np.abs(V - 225) < 6))
    found = detect_stripe(photograph(STRIPE, small), RED)
    assert not found.valid[0, GAP].any()
    assert found.valid[0, ~GAP].mean() > 0.99


def test_a_lamp_is_as_thick_as_it_looks():
    """A disc of 33 px was taken for a stripe: its steep flanks told a width of 7."""
    line = np.arange(COLUMNS)
    disc = np.abs(line - 112) <= 16
    chord = np.where(disc, 2 * np.sqrt(np.maximum(16.5**2 - (line - 112.0) ** 2, 1.0)), 2.0)
    values = {"position": 344.0, "strength": 345.0, "width": np.where(disc, 7.0, 2.0), "breadth": chord, "burnt": disc}
    each = {f.name: np.broadcast_to(np.float32(values.get(f.name, 0)), (1, COLUMNS)) for f in fields(Measured)}
    measured = Measured(**{**each, "burnt": disc[None]})
    assert not in_a_line(measured, disc[None], np.array([20.0]), np.array([LN_WIDTHS]))[0].any()


def test_why_a_line_has_no_point_is_told():
    verdict = detect_stripe(photograph(STRIPE + GHOST), RED).verdict[0]
    assert (verdict[GAP] == Verdict.SECOND).mean() > 0.8
    assert (verdict[~GAP] == Verdict.STRIPE).mean() > 0.97


def test_a_frame_does_not_depend_on_those_beside_it():
    frames = np.stack([photograph(STRIPE + red, white, seed=i) for i, (red, white) in enumerate(CLUTTER.values())])
    together = detect_stripe(frames, RED)
    for i in (0, 3, len(frames) - 1):
        alone = detect_stripe(frames[i], RED)
        np.testing.assert_array_equal(together.valid[i], alone.valid[0])
        np.testing.assert_allclose(together.position[i], alone.position[0], atol=1e-4)


def test_pieces_at_different_depths_are_all_kept():
    pieces = 120 + 60 * (U // 50 % 4)
    found = detect_stripe(photograph(line(pieces, 150.0)), RED)
    assert (np.abs(found.position[0] - pieces) < 3).mean() > 0.98


def test_a_burnt_out_part_of_the_object_is_kept():
    height = np.where((U > 200) & (U < 330), 2500.0, 80.0)
    for settings in (RED, GREY):
        image = photograph(line(CENTRE, height))
        found = detect_stripe(image if settings is RED else image[..., 0], settings)
        assert (np.abs(found.position[0] - CENTRE) < 3).mean() > 0.96


def test_a_thin_wire_before_a_wall_is_kept():
    """It is hardly longer than it is thick, so that in one photograph of many it may be a spot."""
    wire = (U >= 310) & (U < 318)
    centre, kept = np.where(wire, 150.0, CENTRE), 0
    for seed in range(8):
        found = detect_stripe(photograph(line(centre, 150.0, seed=seed), seed=100 + seed), RED)
        near = np.abs(found.position[0] - centre) < 3
        kept += near[wire].mean() > 0.7
        assert near[~wire].mean() > 0.98
    assert kept >= 7


def test_a_stripe_outside_the_band_is_left_out_and_one_within_it_taken():
    image = photograph(line(CENTRE, 70.0) + line(np.full(COLUMNS, 420.0), 150.0, seed=5))
    assert (np.abs(detect_stripe(image, RED).position[0] - 420) < 2).all()
    band = np.full(COLUMNS, 100.0), np.full(COLUMNS, 380.0)
    found = detect_stripe(image, RED, band=band)
    assert (np.abs(found.position[0] - CENTRE) < 3).mean() > 0.98
    alone = detect_stripe(photograph(line(np.full(COLUMNS, 420.0), 150.0)), RED, band=band)
    assert not alone.valid.any()
    assert (alone.verdict == Verdict.OUTSIDE).mean() > 0.98


@pytest.mark.parametrize(("peak", "s"), [(57, 1.5), (114, 0.8), (114, 4.0)])
def test_a_stripe_in_noise_is_kept(peak, s):
    image = photograph(line(CENTRE, peak, s, contrast=0.05), noise=15.0)
    found = detect_stripe(image, RED)
    near = np.abs(found.position[0] - CENTRE) < 3
    assert near.mean() > (0.93 if peak > 100 else 0.85)
    assert (found.valid[0] & ~near).sum() <= 2


def test_noise_alone_is_no_faint_stripe():
    image = np.stack([photograph(np.zeros((ROWS, COLUMNS)), seed=i, noise=12.0) for i in range(4)])
    assert detect_stripe(image, RED).valid.sum() == 0
    assert detect_stripe(image[:, :80, :, 0], GREY).valid.sum() == 0


@pytest.mark.parametrize(("count", "strength", "kept"), [(3, 21.0, False), (3, 40.0, True), (8, 21.0, True)])
def test_a_few_points_hardly_brighter_than_noise_are_no_stripe(count, strength, kept):
    """In a shadow three of them were points, five millimetres off: noise on a pattern that was seen in colour."""
    lines = 380 + 2 * np.arange(count)
    seen = np.zeros((1, COLUMNS), bool)
    seen[0, lines] = True
    at, bright, wide = (np.full((1, COLUMNS), x, np.float32) for x in (212.0, strength, 1.9))
    measured = SimpleNamespace(position=at, strength=bright, width=wide, thickness=wide)
    found, _ = in_a_line(measured, seen, np.array([20.3]), np.array([LN_WIDTHS]))
    assert (found == (seen & kept)).all()


@pytest.mark.parametrize(("strength", "kept"), [(7.0, False), (12.0, True)])
def test_beside_a_weak_stripe_what_is_much_fainter_is_none(strength, kept):
    """Edges in the light of a room leave runs of such points in a JPEG, up to 239 mm off."""
    lines = np.arange(COLUMNS)
    stripe, alone = lines < 300, (lines > 340) & (lines < 400)
    at = np.where(stripe, 200.0, 240.0)
    bright, wide = np.where(stripe, 40.0, strength), np.full(COLUMNS, 2.0)
    runs = faint_runs(stripe | alone, at, bright, wide, ROWS, stripe, least_alone=10.0).runs
    assert runs[stripe].all()
    assert (runs[alone] == kept).all()
    goes_on = faint_runs(stripe | alone, np.full(COLUMNS, 200.0), bright, wide, ROWS, stripe, least_alone=np.inf).runs
    assert not goes_on[alone].any()
    near = stripe | (lines < 340)
    assert faint_runs(near, np.full(COLUMNS, 200.0), bright, wide, ROWS, stripe, least_alone=np.inf).runs[near].all()


@pytest.mark.parametrize(("every_second", "kept"), [(True, True), (False, False)])
def test_lines_of_two_widths_in_turn_are_one_stripe(every_second, kept):
    """Behind a mosaic of colours the lines that did not see the laser's colour are broad."""
    random = np.random.default_rng(0)
    wide = (
        np.where(np.arange(40) % 2 == 0, 1.0, 4.5) if every_second else np.geomspace(1, 40, 40)[random.permutation(40)]
    )
    seen = np.ones((1, 40), bool)
    measured = SimpleNamespace(
        position=np.full((1, 40), 100.0), strength=np.full((1, 40), 60.0), width=wide[None], thickness=wide[None]
    )
    found, _ = in_a_line(measured, seen, np.array([20.0]), np.array([LN_WIDTHS]))
    assert (found.mean() > 0.9) == kept


@pytest.mark.parametrize(("color", "surface"), [("red", (40, 120, 60)), ("green", (150, 60, 60))])
def test_a_stripe_on_a_surface_of_another_colour_is_no_white_light(color, surface):
    """A third of its points were called spots, where other parts of the frame made it doubtful."""
    random = np.random.default_rng(0)
    columns, rows = np.arange(640), np.arange(200)[:, None]
    centre = 90 + 8 * np.sin(columns / 90) + 20 * ((columns > 200) & (columns < 380))
    light = 60 * np.exp(-0.5 * ((rows - centre) / 1.2) ** 2) * random.gamma(25, 1 / 25, (200, 640))
    seen = np.stack([(1.0 if name == color else 0.06) * light for name in ("red", "green", "blue")], axis=-1) + surface
    seen += np.sqrt(0.5 + 0.03 * seen) * random.standard_normal(seen.shape)
    stripe = detect_stripe(np.rint(seen.clip(0, 255)).astype(np.uint8), StripeSettings(color))
    assert stripe.valid.mean() > 0.97
