"""The middle of a sheet that has a thickness: against stripes whose light is summed up point by point on a ball."""

from dataclasses import replace
from itertools import pairwise

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from jaxtyping import Float

from jaxscan.images.stripes.bell import FWHM
from jaxscan.images.stripes.stripe import Stripe, u_and_v
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import RangeImage
from jaxscan.reconstruction.thick_sheet import ThickSheet, frames_apart, middles
from jaxscan.reconstruction.triangulate import FramePoses, Kernel, triangulate
from jaxscan.rig import Camera, Light, LightPlane, Linear, MovingLight, Positions, Rig
from jaxscan.rig.light import distance, laser_place, light_at
from jaxscan.rig.projection import pixel_rays
from jaxscan.simulation import rig_2003
from jaxscan.simulation.swept import MIDDLE, with_sweep

RADIUS, APART, SIGMA, BLUR = 10.0, 1000, 0.25, 0.6
COLUMNS = np.arange(276, 322)
STEPS = np.arange(-9 * APART, 10 * APART, APART)


@pytest.fixture(scope="module")
def rig() -> Rig:
    return rig_2003.simulated_rig(0)


@pytest.fixture(scope="module")
def ball(rig) -> dict[str, np.ndarray]:
    return ball_seen(rig, rig)


def ball_seen(rig: Rig, where: Rig) -> dict[str, np.ndarray]:
    """The stripes of a ball in a blurred image: centre of gravity, standard deviation, and the sheet's own middle.

    Args:
        rig: sees it.
        where: the rig on whose platform it stands.
    """
    R, origin = rig_2003.platform(where)
    middle = origin + R @ np.array([-6.0, 8.0, 6.0])
    fine = np.arange(COLUMNS[0] - 3.0, COLUMNS[-1] + 3.0, 0.25)
    mix = np.exp(-((COLUMNS[:, None] - fine) ** 2) / (2 * (BLUR**2 + 1 / 12)))
    found = {name: np.full((len(STEPS), len(COLUMNS)), np.nan) for name in ("seen", "bell", "true")}
    for f in range(len(STEPS)):
        q = {axis: np.float64(steps[f]) for axis, steps in positions(rig).items()}
        light, place = light_at(rig.light(), q), middle + np.asarray(rig.pose(q).translation)
        rows = np.arange(60.0, 420.0)
        d, _ = on_ball(rig, light, fine, np.broadcast_to(rows, (len(fine), len(rows))), place)
        cross = d[:, :-1] * d[:, 1:] < 0
        whole = cross.sum(axis=1) == 1
        k = np.where(whole, cross.argmax(axis=1), 0)
        near, then = (np.take_along_axis(d, (k + by)[:, None], 1)[:, 0] for by in (0, 1))
        start = np.where(whole, rows[k] - near / (then - near), np.nan)
        v = start[:, None] + np.arange(-6.0, 6.05, 0.1)
        d, shine = on_ball(rig, light, fine, v, place)
        # Whole stripes alone: on one smooth piece, away from the rim.
        whole &= np.isfinite(d).all(axis=1)
        shine = np.where(whole[:, None], shine, 0.0)
        moments = [np.nan_to_num(shine * np.nan_to_num(v) ** n).sum(axis=1) for n in (0, 1, 2)]
        total, first, second = (mix @ moment for moment in moments)
        clear = mix @ ~whole < 1e-3
        with np.errstate(invalid="ignore", divide="ignore"):
            seen = first / total
            found["seen"][f] = np.where(clear, seen, np.nan)
            found["bell"][f] = np.sqrt(second / total - seen**2 + BLUR**2)
        at = np.searchsorted(fine, COLUMNS)
        # The middle once more, from the fine rows about it.
        j = np.argmin(np.abs(np.nan_to_num(d, nan=np.inf)), axis=1)
        slope = np.gradient(np.nan_to_num(d), axis=1)
        at_j = np.take_along_axis(np.stack([v, d, slope]), j[None, :, None], 2)[..., 0]
        with np.errstate(invalid="ignore", divide="ignore"):
            found["true"][f] = (at_j[0] - 0.1 * at_j[1] / at_j[2])[at]
    return found


def positions(rig: Rig) -> dict[str, np.ndarray]:
    """Of each frame: of the stage, or of the axis that moves the light, about a millimetre apart."""
    light = rig.light()
    return {light.axis: MIDDLE + 17 * STEPS // APART} if isinstance(light, MovingLight) else {"stage": STEPS}


def on_ball(
    rig: Rig,
    sheet: Light,
    u: Float[np.ndarray, "columns"],
    v: Float[np.ndarray, "columns rows"],
    middle: Float[np.ndarray, "3"],
) -> tuple[Float[np.ndarray, "columns rows"], Float[np.ndarray, "columns rows"]]:
    """How far off the sheet what pixels see of the ball lies, mm, and its light; NaN where they pass it."""
    pixels = np.stack([np.broadcast_to(u[:, None], v.shape), v], axis=-1).reshape(-1, 2)
    rays = pixel_rays(rig.camera, np.nan_to_num(pixels))
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    b = rays @ middle
    with np.errstate(invalid="ignore"):
        X = rays * (b - np.sqrt(b**2 - middle @ middle + RADIUS**2))[:, None]
    to_laser = laser_place(rig.light()) - X
    cosine = ((X - middle) * to_laser).sum(axis=1) / RADIUS / np.linalg.norm(to_laser, axis=1)
    d = np.where(np.isfinite(pixels[:, 1]), distance(sheet, X), np.nan)
    shine = np.maximum(cosine, 0) * np.exp(-(d**2) / (2 * SIGMA**2))
    return d.reshape(v.shape), shine.reshape(v.shape)


def looked(
    rig: Rig,
    seen: Float[np.ndarray, "frames columns"],
    bell: Float[np.ndarray, "frames columns"] | float = 0.8,
    columns: bool = True,
) -> tuple[RangeImage, Stripe]:
    """What a detector would give of these stripes, over the whole width of the image."""
    width = rig.camera.image_size[0 if columns else 1]
    wide = np.full((len(seen), width), np.nan, np.float32)
    wide[:, COLUMNS] = FWHM * bell
    position = np.full((len(seen), width), np.nan, np.float32)
    position[:, COLUMNS] = seen
    q = positions(rig)
    frames = FramePoses.create(rig.motion, q, len(seen))
    u, v = map(jnp.asarray, u_and_v(position, columns))
    points = np.asarray(triangulate(kernel_at(rig, q), frames, u, v))
    valid, one = np.isfinite(points).all(axis=-1), np.ones_like(position)
    frame = np.zeros(len(seen), np.float32)
    stripe = Stripe(
        position,
        0.05 * one,
        200 * one,
        wide,
        wide,
        valid,
        valid.astype(np.int8),
        np.zeros_like(valid),
        np.zeros((len(seen), 4), np.float32),
        frame > 0,
        frame,
        frame > 0,
        frame,
        np.zeros((len(seen), 1, 1), np.float32),
    )
    image = RangeImage(points, position, 200 * one, one, one, valid, q, rig.motion, (rig.light(),), width=stripe.width)
    return image, stripe


def kernel_at(rig: Rig, q: Positions) -> Kernel:
    kernel = Kernel.create(rig)
    return kernel.with_lights(light_at(rig.light(), q)) if isinstance(rig.light(), MovingLight) else kernel


def corrected(rig: Rig, parts: list[tuple[RangeImage, Stripe]], columns: bool = True) -> RangeImage:
    sheet = ThickSheet.create(rig, "", SIGMA, columns)
    apart = frames_apart(rig, "", SIGMA, {axis: steps[:2] for axis, steps in positions(rig).items()})

    def light_of(q: Positions) -> tuple[ThickSheet, Kernel]:
        moves = isinstance(rig.light(), MovingLight)
        return sheet.with_lights(light_at(rig.light(), q)) if moves else sheet, kernel_at(rig, q)

    return RangeImage.joined([image for image, _ in middles(parts, apart, light_of, rig.motion)])


def test_a_ball_is_found_where_it_is(rig, ball):
    image, stripe = looked(rig, ball["seen"], ball["bell"])
    found = corrected(rig, [(image, stripe)])
    moved = found.pixels != image.pixels
    before, after = (each.pixels[:, COLUMNS] - ball["true"] for each in (image, found))
    moved = moved[:, COLUMNS] & np.isfinite(before)
    assert moved.sum() > 120
    assert 0.01 < before[moved].mean() < 0.03
    assert abs(after[moved].mean()) < 0.2 * before[moved].mean()
    # Away from the ends of the stripe, where its bend is not known.
    whole = moved & (np.stack([np.roll(moved, by, axis=1) for by in range(-6, 7)]).all(axis=0))
    assert whole.sum() > 30
    assert np.abs(before[whole]).min() > 0.008
    assert np.sqrt(np.mean(after[whole] ** 2)) < 0.08 * before[whole].mean()
    # Points go where the pixels do.
    again, _ = looked(rig, found.pixels[:, COLUMNS], ball["bell"])
    np.testing.assert_allclose(found.points, again.points, atol=1e-5)


def test_under_a_light_that_moves_a_ball_is_found_where_it_is(rig):
    """By the sheet as it stands in each frame."""
    swept = with_sweep(rig, 0)
    ball = ball_seen(swept, rig)
    image, stripe = looked(swept, ball["seen"], ball["bell"])
    found = corrected(swept, [(image, stripe)])
    before, after = (each.pixels[:, COLUMNS] - ball["true"] for each in (image, found))
    moved = (found.pixels != image.pixels)[:, COLUMNS] & np.isfinite(before)
    assert moved.sum() > 120
    assert 0.01 < before[moved].mean() < 0.03
    assert abs(after[moved].mean()) < 0.2 * before[moved].mean()
    again, _ = looked(swept, found.pixels[:, COLUMNS], ball["bell"])
    np.testing.assert_allclose(found.points, again.points, atol=1e-5)


def test_rows_are_columns_of_a_camera_that_lies_on_its_side(rig, ball):
    by_columns = corrected(rig, [looked(rig, ball["seen"], ball["bell"])])
    c, plane, stage = rig.camera, np.asarray(rig.light().plane), np.asarray(rig.axis("stage").per_step)
    turned = [np.stack([np.asarray(x) for x in pair])[::-1] for pair in (c.focal, c.principal)]
    with float64():
        camera = Camera.create(c.image_size[::-1], *turned, "radial1", np.stack(jax.tree.leaves(c.lens)))
        lying = as_numpy(Rig(camera, (LightPlane.create(plane[[1, 0, 2]]),), Linear.create(stage[[1, 0, 2]])))
    by_rows = corrected(lying, [looked(lying, ball["seen"], ball["bell"], columns=False)], columns=False)
    np.testing.assert_allclose(by_rows.pixels, by_columns.pixels, atol=2e-4)


def test_points_do_not_depend_on_what_is_looked_at_together(rig, ball):
    image, stripe = looked(rig, ball["seen"], ball["bell"])
    whole = corrected(rig, [(image, stripe)])
    for sizes in ((1,) * len(STEPS), (2, 16, 1), (5, 5, 5, 4)):
        ends = np.cumsum((0, *sizes))
        parts = [(image[a:b, :], stripe[a:b]) for a, b in pairwise(ends.tolist())]
        cut = corrected(rig, parts)
        np.testing.assert_array_equal(cut.pixels, whole.pixels)
        np.testing.assert_array_equal(cut.points, whole.points)
        np.testing.assert_array_equal(cut.steps, whole.steps)


def test_frames_at_an_end_have_neighbours_on_one_side(rig, ball):
    image, stripe = looked(rig, ball["seen"], ball["bell"])
    f = int(np.isfinite(ball["true"]).sum(axis=1).argmax())
    found = corrected(rig, [(image[: f + 1, :], stripe[: f + 1])])
    before, after = (each.pixels[f, COLUMNS] - ball["true"][f] for each in (image, found))
    assert np.sqrt(np.nanmean(after**2)) < 0.5 * np.sqrt(np.nanmean(before**2))


def test_a_frame_without_neighbours_stays_as_it_is(rig, ball):
    image, stripe = looked(rig, ball["seen"], ball["bell"])
    found = corrected(rig, [(image[5:6, :], stripe[5:6])])
    np.testing.assert_array_equal(found.pixels, image.pixels[5:6])
    np.testing.assert_allclose(found.points, image.points[5:6], atol=1e-5)


def test_a_plane_stays_where_it_is(rig):
    flat = np.full((len(STEPS), len(COLUMNS)), 240.0)
    noise = 0.05 * np.random.default_rng(0).standard_normal(flat.shape)
    image, stripe = looked(rig, flat + noise)
    off = corrected(rig, [(image, stripe)]).pixels - image.pixels
    # A tenth of the noise that it is read from.
    assert np.sqrt(np.nanmean(off**2)) < 0.005
    assert abs(np.nanmean(off)) < 0.0005


def test_of_a_burnt_out_stripe_the_ends_show_the_middle(rig, ball):
    """Where the core is full the centre is that of the ends, which a skewed stripe has further off."""
    image, stripe = looked(rig, ball["seen"], ball["bell"])
    wide = stripe.width / FWHM
    burnt = replace(stripe, burnt=stripe.valid, breadth=2 * 2.7 * wide)
    plain, ends = corrected(rig, [(image, stripe)]), corrected(rig, [(image, burnt)])
    further = (ends.pixels - image.pixels) - (plain.pixels - image.pixels)
    moved = plain.pixels != image.pixels
    assert np.nanmean(further[moved]) < -0.001


def test_how_many_frames_lie_between(rig):
    def apart(step: int, sigma_mm: float = SIGMA) -> int:
        return frames_apart(rig, "", sigma_mm, {"stage": np.array([0, step])})

    assert apart(5000) == 2
    assert apart(1000) == 2
    assert apart(100) == 14
    assert apart(1000, 0.05) == 2
    assert apart(0) == 0
    assert apart(1) == 0
