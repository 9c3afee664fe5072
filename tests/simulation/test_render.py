"""Photographs against closed forms: outlines, edges, corners, the stripe, and the numbers that the sensor makes."""

from dataclasses import replace

import cv2
import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.errors import InputError
from jaxscan.geometry import vector_to_matrix
from jaxscan.images import Board
from jaxscan.precision import as_float64, float64
from jaxscan.rig import Fixed, Rig
from jaxscan.simulation.light import Lighting, Sensor, default_source
from jaxscan.simulation.render import render
from jaxscan.simulation.scene import Body, Scene
from jaxscan.simulation.shapes import board_plate, grey
from jaxscan.simulation.solids import Sphere

BOARD = Board.checkerboard((4, 3), 16.0)
FULL = 65535.0
DARK = (0.0, 0.0, 0.0)


def pose(rotation: list[float], translation: list[float]) -> tuple[np.ndarray, np.ndarray]:
    with float64():
        return np.asarray(vector_to_matrix(jnp.asarray(rotation, jnp.float64))), np.asarray(translation)


TILTED = pose([0.25, -0.3, 0.06], [-28.0, -22.0, 300.0])


def board_scene(R: np.ndarray, translation: np.ndarray) -> Scene:
    return Scene((board_plate(BOARD).moved(R, translation),), DARK)


def project(rig: Rig, points: np.ndarray) -> np.ndarray:
    with float64():
        return np.asarray(jax.vmap(as_float64(rig.camera).project)(jnp.asarray(points)))


def test_outline_of_a_sphere(rig: Rig, plain_light: Lighting, exact: Sensor) -> None:
    centre, radius = np.array([20.0, -12.0, 300.0]), 31.0
    image = render(rig, Scene((Body(Sphere(centre, radius), grey(1.0)),), DARK), lighting=plain_light, sensor=exact)
    coverage = image[..., 0] / FULL * 255 / 200
    # The rays that touch the sphere do so on a circle around the axis to its centre.
    distance = np.linalg.norm(centre)
    axis = centre / distance
    side = np.cross(axis, [0, 1, 0]) / np.linalg.norm(np.cross(axis, [0, 1, 0]))
    angle = np.linspace(0, 2 * np.pi, 20000, endpoint=False)[:, None]
    reach = np.sqrt(distance**2 - radius**2)
    around = side * np.cos(angle) + np.cross(axis, side) * np.sin(angle)
    outline = project(rig, axis * reach**2 / distance + around * radius * reach / distance)
    x, y = outline.T
    cross = x * np.roll(y, -1) - y * np.roll(x, -1)
    area = cross.sum() / 2
    middle = np.array([((x + np.roll(x, -1)) * cross).sum(), ((y + np.roll(y, -1)) * cross).sum()]) / (6 * area)
    v, u = np.mgrid[: image.shape[0], : image.shape[1]]
    assert coverage.sum() == pytest.approx(abs(area), rel=3e-4)
    found = np.array([(coverage * u).sum(), (coverage * v).sum()]) / coverage.sum()
    np.testing.assert_allclose(found, middle, atol=0.002)


def test_edges_of_a_board(rig: Rig, plain_light: Lighting, exact: Sensor) -> None:
    R, translation = pose([0.0, 0.0, 0.05], [-28.0, -22.0, 300.0])
    image = render(rig, board_scene(R, translation), lighting=plain_light, sensor=exact)[..., 1] / FULL * 255
    # The left edge of the plate: what is bright in a row, from the left up to the middle of the white margin.
    ends = project(rig, np.array([[-24.0, -10.0, 0.0], [-24.0, 40.0, 0.0]]) @ R.T + translation)
    rows = np.arange(int(ends[0, 1]) + 2, int(ends[1, 1]) - 2)
    expected = np.interp(rows, ends[:, 1], ends[:, 0])
    level = image[rows][:, : int(expected.max()) + 3]
    found = level.shape[1] - 0.5 - level.sum(1) / level[:, -1]
    error = found - expected
    # A single row is placed by 75 rays; the edge, by all of them.
    assert np.sqrt(np.mean(error**2)) < 0.008
    assert np.abs(np.polyval(np.polyfit(rows, error, 1), rows[[0, -1]])).max() < 0.003


@pytest.mark.parametrize("k1", [0.0, -0.3])
def test_pixels_of_a_board_by_brute_force(
    rig: Rig, lens_rig: Rig, plain_light: Lighting, exact: Sensor, k1: float
) -> None:
    rig = lens_rig if k1 else rig
    R, translation = TILTED
    image = render(rig, board_scene(R, translation), lighting=plain_light, sensor=exact)[..., 2] / FULL * 255
    n, low, high = 30, (50, 35), (90, 65)
    v, u = ((np.arange(n * (high[i] - low[i])) + 0.5) / n - 0.5 + low[i] for i in (1, 0))
    f, c = (np.array([float(x) for x in pair]) for pair in (rig.camera.focal, rig.camera.principal))
    pixels = np.stack(np.meshgrid(u, v), -1).reshape(-1, 1, 2)
    K = np.array([[f[0], 0, c[0]], [0, f[1], c[1]], [0, 0, 1]])
    criteria = (cv2.TERM_CRITERIA_COUNT | cv2.TERM_CRITERIA_EPS, 50, 1e-12)
    undistorted = cv2.undistortPoints(pixels, K, np.array([k1, 0, 0, 0]), criteria=criteria).reshape(-1, 2)
    rays = np.column_stack([undistorted, np.ones(len(undistorted))])
    # The board plane in its own coordinates: R^T (t x − translation) has z = 0.
    origin, local = -R.T @ translation, rays @ R
    x, y = (origin[:2] - local[:, :2] * (origin[2] / local[:, 2])[:, None]).T
    i, j = np.floor(x / 16) + 1, np.floor(y / 16) + 1
    ink = (i >= 0) & (i <= 4) & (j >= 0) & (j <= 3) & ((i + j) % 2 == 0)
    inside = (x > -24) & (x < 72) & (y > -24) & (y < 56)
    fine = np.where(inside, np.where(ink, 0.3, 1.0) * 0.9 * 200, 0.0)
    expected = fine.reshape(high[1] - low[1], n, high[0] - low[0], n).mean((1, 3))
    error = image[low[1] : high[1], low[0] : high[0]] - expected
    assert np.ptp(expected) > 120
    assert np.abs(error).max() < 2.0
    assert np.sqrt(np.mean(error**2)) < 0.4


def test_stripe_on_a_board(lens_rig: Rig) -> None:
    R, translation = TILTED
    lighting = Lighting(ambient=0.0, directional=0.0, laser_power=150.0)
    plain = Scene((board_plate(BOARD, ink=1.0).moved(R, translation),), DARK)
    image = render(lens_rig, plain, laser=0, lighting=lighting, sensor=Sensor(noise=0, bits=16))[..., 0] / FULL * 255
    strength = image.sum(0)
    columns = np.flatnonzero(strength > 0.9 * np.median(strength[strength > 10]))[2:-2]
    assert len(columns) > 40
    v = np.arange(image.shape[0])[:, None]
    found = (image * v).sum(0)[columns] / strength[columns]
    # In the column the ray meets board and sheet in one point: (ω − β) · x = 0.
    beta = R[:, 2] / (R[:, 2] @ translation)
    omega = np.array([float(c) for c in lens_rig.lights[0].plane])
    rows = np.linspace(0, image.shape[0] - 1, 4001)
    with float64():
        camera = as_float64(lens_rig.camera)
        pixels = jnp.asarray(np.stack(np.meshgrid(columns.astype(float), rows), -1).reshape(-1, 2))
        g = (np.asarray(jax.vmap(camera.ray)(pixels)) @ (omega - beta)).reshape(len(rows), len(columns))
    expected = np.array([np.interp(0, g[:, i] * np.sign(g[-1, i] - g[0, i]), rows) for i in range(len(columns))])
    assert np.abs(found - expected).max() < 0.01


def test_laser_light_where_it_can_reach(rig: Rig) -> None:
    """One ball stands between the laser and a plate, another between the camera and the plate."""
    lighting = Lighting(ambient=0, directional=0, laser_power=200.0, laser_source=(-150.0, 1 / -0.00494, 0.0))
    plate = board_plate(BOARD, margin_mm=60, ink=1.0).moved(np.eye(3), np.array([-24.0, -16.0, 340.0]))
    source = np.asarray(lighting.laser_source)
    before_laser, before_camera, radius = np.array([-40.0, -29.0, 280.0]), np.array([30.0, 5.0, 280.0]), 8.0
    balls = tuple(Body(Sphere(centre, radius), grey(0.0)) for centre in (before_laser, before_camera))
    free, shadowed = (
        render(rig, Scene(bodies, DARK), laser=0, lighting=lighting, sensor=Sensor(noise=0, blur_px=0, bits=16))
        for bodies in ((plate,), (plate, *balls))
    )
    # Points of the plate on the sheet, and how far the balls are from the lines to the laser and to the camera.
    omega = np.array([0.0, -0.00494, 0.00303])
    x = np.linspace(-60, 60, 61)
    points = np.column_stack([x, np.full(61, (1 - omega[2] * 340) / omega[1]), np.full(61, 340.0)])
    towards = (source - points) / np.linalg.norm(source - points, axis=1)[:, None]
    sight = points / np.linalg.norm(points, axis=1)[:, None]
    off_laser = np.linalg.norm(np.cross(before_laser - points, towards), axis=1)
    off_camera = np.linalg.norm(np.cross(before_camera, sight), axis=1)
    u, v = np.round(project(rig, points)).astype(int).T
    dark = shadowed[v, u, 0] < 0.02 * free[v, u, 0]
    # Half a pixel is 0.85 mm of the plate.
    unlit, unseen = off_laser < radius - 1, off_camera < radius - 1
    clear = (off_laser > radius + 1) & (off_camera > radius + 1)
    assert (free[v, u, 0] > 0).all()
    assert unlit.sum() > 3
    assert unseen.sum() > 3
    assert clear.sum() > 30
    assert dark[unlit | unseen].all()
    assert not dark[clear].any()


def test_stage_moves_what_stands_on_it(rig: Rig, plain_light: Lighting, exact: Sensor) -> None:
    moving, fixed = (Body(Sphere(np.array([0.0, -8.0, 300.0]), 9.0), grey(1.0), on_stage=on) for on in (True, False))
    per_step = np.array([0.00003, 0.00092, -0.00039])
    shifted = Body(Sphere(np.array([0.0, -8.0, 300.0]) + 20000 * per_step, 9.0), grey(1.0))

    def shoot(body: Body, steps: int) -> np.ndarray:
        return render(rig, Scene((body,), DARK), q={"stage": steps}, lighting=plain_light, sensor=exact)

    np.testing.assert_array_equal(shoot(moving, 20000), shoot(shifted, 0))
    np.testing.assert_array_equal(shoot(fixed, 20000), shoot(moving, 0))


def test_sensor_noise_saturation_and_depth(rig: Rig, plain_light: Lighting) -> None:
    wall = board_plate(BOARD, margin_mm=300, ink=1.0, white=0.5).moved(np.eye(3), np.array([0.0, 0.0, 300.0]))
    scene = Scene((wall,), DARK)
    noisy = render(rig, scene, lighting=plain_light, sensor=Sensor(noise=2.0), seed=3).astype(float)
    assert noisy.mean() == pytest.approx(100, abs=0.05)
    # Rounding adds a twelfth of a squared grey level.
    assert noisy.std() == pytest.approx(np.sqrt(4 + 1 / 12), rel=0.02)
    deep = render(rig, scene, lighting=plain_light, sensor=Sensor(noise=0, bits=16))
    assert deep.dtype == np.uint16
    assert (deep == 100 * 257).all()
    for sensor, top in ((Sensor(gain=3.0, noise=0), 255), (Sensor(gain=3.0, noise=0, saturation=240), 240)):
        assert (render(rig, scene, lighting=plain_light, sensor=sensor) == top).all()


def test_a_mosaic_keeps_one_colour_of_each_pixel(rig: Rig, plain_light: Lighting) -> None:
    wall = board_plate(BOARD, margin_mm=300, ink=1.0, white=0.5).moved(np.eye(3), np.array([0.0, 0.0, 300.0]))
    for bits in (8, 16):
        full, seen = (
            render(
                rig,
                Scene((wall,), DARK),
                lighting=plain_light,
                sensor=Sensor(noise=9.0, bits=bits, mosaic=mosaic),
                seed=3,
            )
            for mosaic in (False, True)
        )
        assert seen.dtype == full.dtype
        # The outermost pixels repeat those beside them.
        for color, (row, column) in enumerate(((2, 2), (3, 2), (3, 3))):
            own = slice(row, -1, 2), slice(column, -1, 2), color
            np.testing.assert_array_equal(seen[own], full[own])
        means = (full[2:-4:2, 2:-2:2, 0].astype(int) + full[4:-2:2, 2:-2:2, 0]) / 2
        assert np.abs(seen[3:-3:2, 2:-2:2, 0] - means).max() <= 0.5


def test_seed_determines_the_photograph(rig: Rig) -> None:
    scene = board_scene(*TILTED)
    lighting = Lighting(speckle=0.5)
    first, again, other = (render(rig, scene, laser=0, lighting=lighting, seed=seed) for seed in (1, 1, 2))
    np.testing.assert_array_equal(first, again)
    assert (first != other).mean() > 0.3


def test_speckle_is_of_the_laser_alone(rig: Rig, exact: Sensor) -> None:
    scene = board_scene(*TILTED)
    steady, speckled = (Lighting(speckle=s, laser_power=300.0, laser_colour=(1.0, 0.0, 0.0)) for s in (0.0, 0.8))
    a, b = (render(rig, scene, laser=0, lighting=light, sensor=exact) for light in (steady, speckled))
    np.testing.assert_array_equal(a[..., 1:], b[..., 1:])
    assert (a[..., 0] != b[..., 0]).sum() > 100
    off = [render(rig, scene, lighting=light, sensor=exact) for light in (steady, speckled)]
    np.testing.assert_array_equal(*off)


def test_laser_stands_on_its_sheet_and_on_an_image_axis() -> None:
    for omega in (np.array([0.001, -0.005, 0.003]), np.array([-0.006, 0.002, 0.003])):
        source = default_source(omega)
        assert omega @ source == pytest.approx(1)
        assert np.count_nonzero(source) == 1


def test_what_cannot_be_is_refused(rig: Rig) -> None:
    scene = board_scene(*TILTED)
    with pytest.raises(InputError, match="laser = 1"):
        render(rig, scene, laser=1)
    with pytest.raises(InputError, match='no axis "stage"'):
        render(replace(rig, motion=Fixed()), scene, q={"stage": 5})
    with pytest.raises(InputError, match='no axis "turntable", it has stage'):
        render(rig, scene, q={"stage": 5, "turntable": 0})
    for wrong in ({"bits": 12}, {"noise": -1.0}, {"saturation": 300.0}, {"blur_px": -1.0}, {"gain": 0.0}):
        with pytest.raises(InputError):
            Sensor(**wrong)
    for wrong in (
        {"speckle": 1.5},
        {"speckle": np.nan},
        {"speckle_length_px": (-1.0, 0.0)},
        {"speckle_length_px": (0.0, 1e9)},
        {"sheet_sigma_mm": 0.0},
        {"ambient": -1.0},
        {"ambient_colour": (1.0, 1.2, 0.4)},
        {"laser_colour": (1.0, -0.1, 0.0)},
        {"highlight": -5.0},
        {"highlight": np.inf},
        {"highlight_deg": 0.0},
        {"ghost": 1.5},
    ):
        with pytest.raises(InputError, match=next(iter(wrong))):
            Lighting(**wrong)
