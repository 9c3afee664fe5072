"""Stripes on surfaces of many colours, in the light of a room."""

import jax
import numpy as np
import pytest

from benchmarks.painted import ROWS, painted
from benchmarks.video import beside_no_step
from jaxscan.images import StripeSettings, detect_stripe
from jaxscan.images.stripes.batch import Batch

RED = StripeSettings("red")


def off_and_sigma(row, detector="likelihood"):
    photographs, truth = painted(row)
    stripe = detect_stripe(photographs, StripeSettings(row.color), detector=detector)
    asked = beside_no_step(len(truth))
    return np.where(stripe.valid, stripe.position - truth, np.nan)[asked], np.asarray(stripe.sigma)[asked]


@pytest.mark.parametrize(("name", "kept", "beyond"), [("red", 0.85, 0.07), ("green", 0.98, 0.05), ("blue", 0.97, 0.05)])
def test_edges_of_paint_hardly_move_a_stripe_and_are_none(name, kept, beyond):
    off, _ = off_and_sigma(ROWS[name])
    by_gravity, _ = off_and_sigma(ROWS[name], "gravity")
    near, seen = np.abs(off) < 0.5, np.isfinite(off)
    assert (np.abs(off) < 3).mean() > kept
    assert (np.abs(off[seen]) >= 3).mean() < 0.01
    assert 1 - near.sum() / seen.sum() < beyond
    assert np.sqrt(np.mean(off[near] ** 2)) < np.sqrt(np.mean(by_gravity[np.abs(by_gravity) < 0.5] ** 2))


def test_where_no_laser_shines_paint_is_no_stripe():
    photographs, _ = painted(ROWS["red"]._replace(height=0.0))
    assert detect_stripe(photographs, RED).valid.mean() < 0.05


def test_colours_that_a_lens_shows_elsewhere_do_not_move_it():
    off, _ = off_and_sigma(ROWS["colours_apart"])
    by_gravity, _ = off_and_sigma(ROWS["colours_apart"], "gravity")
    ours, its = (abs(np.nanmedian(x)) for x in (off, by_gravity))
    assert ours < max(its, 0.03)


def colours(photographs):
    batch = Batch.create(photographs, None, RED, "likeliest", len(photographs))
    return jax.tree.map(np.asarray, batch.survey().colours)


def test_each_line_has_weights_of_its_own():
    found = colours(painted(ROWS["red"])[0])
    even, loud = (np.add(*found.weights(tau)) for tau in (0.0, 1.0))
    # Of warm paint more is taken off than of what is even.
    assert np.median(loud) > 1.3 * np.median(even)
    assert found.by_line.all()


def test_where_nothing_is_to_cancel_other_channels_bring_nothing_but_noise():
    found = colours(painted(ROWS["no_room"])[0])
    assert (np.add(*found.weights(0.0)) < 0.5).all()


def test_channels_that_show_the_laser_elsewhere_are_known():
    apart = ROWS["colours_apart"]._replace(apart_px=1.0)
    assert not colours(painted(apart)[0]).aligned.any()


def test_a_frame_does_not_depend_on_those_beside_it():
    photographs, _ = painted(ROWS["red"])
    alone, all_of_them = detect_stripe(photographs[:1], RED), detect_stripe(photographs, RED)
    np.testing.assert_array_equal(alone.valid[0], all_of_them.valid[0])
    np.testing.assert_array_equal(alone.position[0], all_of_them.position[0])
