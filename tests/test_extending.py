"""The worked examples of docs/extending.md: each a kind of part in one file, run as it stands there."""

import builtins
import re
import runpy
from dataclasses import replace
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.calibration import BoardSequence, View, calibrate
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, read_rig, write_rig
from jaxscan.precision import as_numpy, float64
from jaxscan.reconstruction import Kernel, Scanner, triangulate
from jaxscan.reconstruction.triangulate import FramePoses
from jaxscan.rig import Rig, motion_of
from tests.calibration import synthetic

PAGE = Path(__file__).parents[1] / "docs" / "extending.md"
EXAMPLES = dict(re.findall(r"```python\n# (\w+)\.py\n(.*?)```", PAGE.read_text(), re.DOTALL))


@pytest.fixture
def example(tmp_path, own_kinds):
    """Runs one of the page's files, and gives what is defined in it."""

    def run(name):
        path = tmp_path / f"{name}.py"
        path.write_text(EXAMPLES[name])
        return runpy.run_path(str(path))

    return run


def test_every_kind_of_the_page_is_tested():
    assert set(EXAMPLES) == {"cylinder_sheet", "division", "crank", "known_distance", "row_maximum", "by_hand"}


BEND = 2e-7


def bent_session():
    """The session with each stripe where the bent sheet is seen on the board."""
    session = synthetic.observations(0, n_stage=5)
    rng, noise, views = np.random.default_rng(0), np.random.default_rng(1), []
    for view in session.views:
        R, t = synthetic.board_pose(rng)
        rng.normal(size=view.corners.shape)
        rng.normal(size=len(view.stripes[0].pixels))
        # Along the board's x, the y of the stripe by Newton's steps.
        x = np.linspace(-120, 250, 3000)
        y = np.zeros_like(x)
        for _ in range(20):
            X = np.stack([x, y, 0 * x], axis=1) @ R.T + t
            level = X @ synthetic.OMEGA - 1 - BEND * X[:, 0] ** 2
            y -= level / (R[:, 1] @ synthetic.OMEGA - 2 * BEND * X[:, 0] * R[0, 1])
        seen = synthetic.project(X)
        order = np.argsort(seen[:, 0])
        columns = np.arange(640.0)
        rows = np.interp(columns, seen[order, 0], seen[order, 1], left=np.nan, right=np.nan)
        rows[(rows < 0) | (rows > 479)] = np.nan
        rows += 0.1 * noise.normal(size=rows.shape)
        stripe = replace(view.stripes[0], pixels=np.stack([columns, rows], axis=1))
        views.append(replace(view, stripes=(stripe,)))
    return replace(session, views=tuple(views))


def test_a_sheet_on_a_cylinder_is_found_written_and_triangulated(example, tmp_path):
    example("cylinder_sheet")
    session = bent_session()
    found, flat = calibrate(session, light="cylinder"), calibrate(session)
    bend, sigma = float(found.rig.lights[0].bend[0]), found.covariance.sigma("lights.0.bend.0")
    assert abs(bend - BEND) < 4 * sigma < 0.5 * BEND
    assert found.stripe_rms_px < 0.105
    assert flat.stripe_rms_px > 1.5 * found.stripe_rms_px
    write_rig(tmp_path / "rig.json", found.rig_file())
    back = read_rig(tmp_path / "rig.json")
    assert jax.tree.leaves(back.rig) == jax.tree.leaves(found.rig)
    pixels = np.stack(np.meshgrid(np.arange(50.0, 600, 50), np.arange(20.0, 200, 20)), axis=-1).reshape(1, -1, 2)
    points = np.asarray(
        triangulate(
            Kernel.create(back.rig),
            FramePoses.create(back.rig.motion, {}, 1),
            *map(jnp.asarray, pixels.T[..., 0][:, None]),
        )
    )[0]
    with float64():
        exact = np.asarray(jax.vmap(lambda p: back.rig.triangulate(p, {}))(jnp.asarray(pixels[0])))
    seen = np.isfinite(exact).all(axis=1) & (exact[:, 2] < 600)
    assert seen.sum() > 40
    np.testing.assert_allclose(points[seen], exact[seen], atol=3e-3)
    with pytest.raises(InputError, match="this version knows plane, bowed, swept, cylinder"):
        calibrate(session, light="wavy")


def test_a_lens_of_the_page_is_found_and_written(example, tmp_path):
    example("division")
    session = synthetic.observations(0, n_stage=0)
    found = calibrate(session, lens="division")
    assert found.corner_rms_px < 0.08
    assert abs(found.rig.camera.focal[0] - synthetic.FOCAL[0]) < 1
    # Of small errors both lenses are the same to the first order.
    assert abs(found.rig.camera.lens.division[0] - synthetic.K1) < 0.03
    with pytest.raises(InputError, match=r'lens "division" has .*, camera.division.0$'):
        calibrate(session, lens="division", hold=["camera.radial.0"])
    write_rig(tmp_path / "rig.json", found.rig_file())
    back = read_rig(tmp_path / "rig.json")
    assert jax.tree.leaves(back.rig) == jax.tree.leaves(found.rig)


def test_a_crank_is_found_from_a_board_that_it_carries(example, tmp_path):
    example("crank")
    reach, turn, steps = np.array([1.0, 18.0, -8.0]), 0.013, np.arange(0.0, 480.0, 40.0)
    rng, points = np.random.default_rng(4), synthetic.BOARD.points()
    R, t = synthetic.board_pose(rng)
    views = []
    for n in steps:
        X = points @ R.T + t + reach * np.sin(turn * n)
        views.append(View(f"crank-{n:g}", synthetic.project(X) + 0.05 * rng.normal(size=(len(points), 2))))
    session = replace(
        synthetic.observations(4, n_stage=0),
        sequences=(BoardSequence({"crank": steps}, tuple(views), "crank", "crank"),),
    )
    found = calibrate(session)
    crank = found.rig.axis("crank")
    values = np.array([float(x) for x in jax.tree.leaves(crank)])
    sigmas = [found.covariance.sigma(f"motion.crank.{name}") for name in ("reach.0", "reach.1", "reach.2", "turn.0")]
    assert np.abs((values - [*reach, turn]) / sigmas).max() < 4.5
    write_rig(tmp_path / "rig.json", found.rig_file())
    assert jax.tree.leaves(read_rig(tmp_path / "rig.json").rig) == jax.tree.leaves(found.rig)


def test_a_known_distance_lowers_the_scale_error(example):
    KnownDistance = example("known_distance")["KnownDistance"]
    session = synthetic.observations(1, n_views=4, n_stage=5)
    pixels, steps = np.array([[[250.0, 120.0], [420.0, 130.0]]]), np.array([[0.0, 8000.0]])
    with jax.enable_x64(True):
        camera = synthetic_rig()
        P = [
            np.asarray(camera.triangulate(jnp.asarray(p), {"stage": n}))
            for p, n in zip(pixels[0], steps[0], strict=True)
        ]
        factor = KnownDistance(*map(jnp.asarray, (pixels, steps, [np.linalg.norm(P[1] - P[0])], 0.001)))
    without, found = calibrate(session), calibrate(session, factors=[factor])
    name = "lights.0.plane.1"
    assert found.covariance.sigma(name) < 0.95 * without.covariance.sigma(name)
    values = dict(zip(found.covariance.names, map(float, jax.tree.leaves(found.rig)), strict=True))
    assert all(abs(values[n] - synthetic.TRUTH[n]) < 4.5 * found.covariance.sigma(n) for n in synthetic.TRUTH)


def synthetic_rig() -> Rig:
    from jaxscan.rig import Camera, LightPlane, Linear

    camera = Camera.create(synthetic.IMAGE_SIZE, synthetic.FOCAL, synthetic.PRINCIPAL, "radial1", [synthetic.K1])
    return as_numpy(Rig(camera, (LightPlane.create(synthetic.OMEGA),), motion_of((Linear.create(synthetic.PER_STEP),))))


def test_the_row_of_the_maximum_measures(example):
    from tests.reconstruction.small import small_rig, wavy_stripe

    example("row_maximum")
    photograph = wavy_stripe(0.0).round().astype(np.uint8)
    grey = replace_grey()
    image = next(Scanner(RigFile(small_rig()), "maximum").frames([(photograph, 0)], grey))
    expected = 40 + 8 * np.sin(np.arange(image.pixels.shape[1]) / 20)
    assert image.valid.mean() > 0.9
    assert np.nanmax(np.abs(image.pixels[0] - expected)) < 0.6
    with pytest.raises(InputError, match=r'no detector "minimum": use one of .*maximum'):
        Scanner(small_rig(), "minimum")


def replace_grey():
    from jaxscan.images import StripeSettings

    return StripeSettings("grey")


def test_a_stage_that_is_moved_by_hand(example, tmp_path, monkeypatch):
    example("by_hand")
    from hardware.devices import open_stage, read_scanner
    from hardware.stages import STAGE_KINDS

    asked = []
    monkeypatch.setattr(builtins, "input", lambda text: asked.append(text))
    path = tmp_path / "scanner.toml"
    table = '[stage]\nkind = "by_hand"\nquestion = "turn to {step}"\n'
    path.write_text(table + '[camera]\nkind = "simulated"\n[laser]\nkind = "simulated"\n')
    try:
        stage = open_stage(read_scanner(path))
        stage.home()
        stage.move_to(1200)
        assert stage.position() == 1200
        assert asked == ["turn to 0", "turn to 1200"]
    finally:
        del STAGE_KINDS["by_hand"]
