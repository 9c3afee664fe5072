"""The viewer in a real browser without a window, and still pictures."""

import io
import os
import shutil
import tomllib
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from jaxscan.cli.main import main
from jaxscan.cli.measure import read_surface
from jaxscan.errors import InputError
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.precision import as_numpy
from jaxscan.reconstruction import write_points
from jaxscan.simulation.rig_2003 import simulated_rig, turning_axes, with_turntable
from jaxscan.view.view_data import PHOTOGRAPH, view_data
from jaxscan.view.viewer import HOST, cell_mm, colour_bar, coloured, limits, serve
from tests.surface.scenes import block

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or os.environ.get("CHROMIUM", "")


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("view")
    write_points(folder / "block.npz", block())
    write_rig(folder / "rig.json", RigFile(simulated_rig(0)))
    assert main(["mesh", str(folder / "block.npz"), "-o", str(folder / "block.ply")]) == 0
    return folder


def test_what_is_shown(folder):
    image = block()
    shown = view_data(folder / "block.npz", simulated_rig(0))
    assert shown.points.dtype == np.float32
    assert set(shown.values) == {"height", "sigma", "strength"}
    np.testing.assert_allclose(np.median(shown.values["height"][shown.points[:, 2] < 297]), 5.0, atol=0.02)
    assert shown.setup is not None
    np.testing.assert_allclose(shown.setup.at.translation[[0, -1]], image.cameras()[[0, -1]])
    omega = [float(c) for c in simulated_rig(0).lights[0].plane]
    np.testing.assert_allclose(shown.setup.sheet @ omega, 1.0, atol=1e-9)
    mesh = view_data(folder / "block.ply")
    assert mesh.triangles is not None
    assert len(mesh.values["sigma"]) == len(mesh.points)
    assert mesh.setup is None
    with pytest.raises(InputError, match='"strength" is not known of these points: choose height, sigma'):
        mesh.colour("strength")


def test_a_turntable_is_gone_round_by_the_camera_and_its_light(tmp_path):
    rig = with_turntable(simulated_rig(0), 0)
    turn = {axis: np.array(steps) for axis, steps in turning_axes(160).items()}
    still = block()[:20, :]
    at = as_numpy(rig.pose({axis: steps.astype(float) for axis, steps in turn.items()})).inverse()
    points = np.einsum("fij,fcj->fci", at.matrix(), still.points) + at.translation[:, None]
    image = replace(still, points=points.astype(np.float32), positions=turn, motion=rig.motion)
    write_points(tmp_path / "turn.npz", image)
    setup = view_data(tmp_path / "turn.npz", rig).setup
    assert setup is not None
    np.testing.assert_allclose(setup.at.translation, at.translation)
    # On a circle, all around.
    out = setup.at.translation - setup.at.translation.mean(axis=0)
    np.testing.assert_allclose(np.linalg.norm(out, axis=1), np.linalg.norm(out[0]), rtol=1e-3)
    omega = [float(c) for c in rig.lights[0].plane]
    carried = as_numpy(rig.pose({axis: np.float64(steps[0]) for axis, steps in turn.items()})).apply(setup.sheet)
    np.testing.assert_allclose(carried @ omega, 1.0, atol=1e-9)


def test_colours_go_from_dark_to_bright():
    colours = coloured(np.array([*np.linspace(0, 1, 101), np.nan]))
    assert (np.diff(colours[:101].astype(float) @ [0.3, 0.59, 0.11]) >= -1).all()
    assert (colours[-1] == 128).all()


def test_the_cells_of_the_grid_are_round_numbers():
    assert [cell_mm(size) for size in (1.2, 12.0, 30.0, 120.0, 130.0, 700.0, 13000.0)] == [0.1, 1, 5, 10, 20, 100, 2000]
    for size in np.geomspace(1e-3, 1e5, 200):
        assert 4 < size / cell_mm(size) <= 12 + 1e-6


def test_the_colour_bar_says_what_its_ends_are(folder):
    shown = view_data(folder / "block.npz")
    bar = colour_bar(shown, "strength")
    low, high = limits(shown.values["strength"])
    assert f"<span>{low:.3g}</span>" in bar
    assert f"<span>{high:.3g}</span>" in bar
    assert "strength, grey levels" in bar
    # Its ends have the colours of these values.
    first, last = (f"rgb({r}, {g}, {b})" for r, g, b in coloured(np.array([0.0, 1.0]))[[0, 1]].tolist())
    assert bar.index(first) < bar.index(last)
    assert colour_bar(shown, PHOTOGRAPH) == ""


@pytest.mark.parametrize("words", ["block.npz --rig rig.json --colour sigma", "block.ply"])
def test_a_still_picture(folder, capsys, monkeypatch, words):
    monkeypatch.chdir(folder)
    assert main(["view", *words.split(), "--png", "seen.png"]) == 0
    assert "coloured by" in capsys.readouterr().out
    assert len(np.unique(np.asarray(Image.open("seen.png").convert("RGB")).reshape(-1, 3), axis=0)) > 100


@pytest.mark.parametrize(
    ("words", "problem"),
    [
        ("gone.npz", "gone.npz: there is no such file"),
        ("block.ply --colour strength --png x.png", 'block.ply: "strength" is not known'),
        ("block.npz --port 0", "--port 0: give a number"),
        ("block.npz --png nowhere/x.png", "there is no folder"),
        ("rig.json", "cannot be read as a mesh"),
    ],
)
def test_bad_input(folder, capsys, monkeypatch, words, problem):
    monkeypatch.chdir(folder)
    assert main(["view", *words.split()]) == 2
    assert problem in capsys.readouterr().err


# What the browser and its library open and leave to the collector is theirs.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_in_a_browser(folder):
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    pytest.importorskip("viser", reason="viser (extra viewer) is not installed")
    if not CHROMIUM:
        pytest.skip("chromium is not installed: no browser to look with")

    def read():
        return read_surface(folder / "block.npz")[0]

    server = serve(view_data(folder / "block.npz", simulated_rig(0)), 8321, read, "strength")
    try:
        assert server.get_host() == HOST == "127.0.0.1"
        with api.sync_playwright() as play:
            flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
            browser = play.chromium.launch(executable_path=CHROMIUM, args=flags)
            page = browser.new_page(viewport={"width": 640, "height": 480})
            page.goto(f"http://{HOST}:{server.get_port()}")
            page.wait_for_function("document.body.innerText.includes('7200 points; strength')", timeout=120_000)
            # Colour bar, scale and grid; the grid can be taken away.
            page.wait_for_function("document.body.innerText.includes('strength, grey levels')")
            cell = cell_mm(float(np.linalg.norm(np.ptp(block().points[block().valid], axis=0))))
            page.wait_for_function(f"document.body.innerText.includes('grid, squares of {cell:g} mm')")
            for _ in range(60):
                page.wait_for_timeout(500)
                picture = np.asarray(Image.open(io.BytesIO(page.screenshot(timeout=120_000))).convert("RGB"))
                inner = picture[200:, :].reshape(-1, 3).astype(int)
                seen = (np.ptp(inner, axis=1) > 40).mean()
                if seen > 0.02:
                    break
            # A click on the block, which stands in the middle: its coordinates, and the regions around it.
            for _ in range(20):
                page.mouse.click(220, 300)
                page.wait_for_timeout(1500)
                if "x, y, z = " in page.inner_text("body"):
                    break
            said = page.inner_text("body").partition("x, y, z = ")[2].partition(" mm")[0]
            page.wait_for_timeout(1000)
            values = [field.input_value() for field in page.locator("input").all()]
            fields = [next(value for value in values if value.startswith(kind)) for kind in ("ball", "box")]
            page.get_by_label("grid, squares of").uncheck()
            page.wait_for_timeout(3000)
            without = np.asarray(Image.open(io.BytesIO(page.screenshot(timeout=120_000))).convert("RGB"))
            ruled = (np.abs(without.astype(int) - picture).max(axis=2) > 40)[:, :300].mean()
            browser.close()
    finally:
        server.stop()
    assert seen > 0.02
    assert ruled > 0.003
    place = np.array([float(word) for word in said.split(",")])
    image = block()
    assert np.linalg.norm(image.points[image.valid] - place, axis=1).min() < 1.5
    ball, box = (tomllib.loads(line) for line in fields)
    np.testing.assert_allclose(ball["ball"][:3], place, atol=0.011)
    np.testing.assert_allclose(np.mean(box["box"], axis=0), place, atol=0.011)
