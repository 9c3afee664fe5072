"""Faces that are clicked in the viewer, in a real browser: a step between two planes, kept as part.toml."""

import contextlib
import os
import re
import shutil
import threading
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from benchmarks.measured_parts import as_image, at, drawn_rig, implicit
from jaxscan.errors import InputError
from jaxscan.files.part_file import Dimension, Feature, Part, read_part
from jaxscan.files.part_write import part_text
from jaxscan.files.region import Region
from jaxscan.files.rig_file import RigFile, write_rig
from jaxscan.measurement.clicked import Click, part_of_clicks
from jaxscan.measurement.measure import measure
from jaxscan.reconstruction import write_points
from jaxscan.rig import Covariance
from jaxscan.rig.rig import parameter_names
from jaxscan.simulation import rig_2003
from jaxscan.view.view_data import view_data

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or os.environ.get("CHROMIUM", "")
RIG = rig_2003.simulated_rig(0)
SIGMAS = (0.2, 0.2, 0.1, 0.1, 4e-4, 5e-7, 1e-6, 1e-6, 1e-7, 1e-7, 2e-7)
KNOWN = RigFile(RIG, Covariance(tuple(parameter_names(RIG)), np.diag(np.square(SIGMAS))))
Y, HIGH = 12.0, 6.0


@pytest.fixture(scope="module")
def scanned(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A floor with a step of 6 mm, scanned with a rig that is not quite the true one: step.npz and rig.json."""
    folder = tmp_path_factory.mktemp("measuring")
    steps = np.arange(2000.0, 26000.0, 600.0)
    position = implicit(lambda x: np.minimum(np.maximum(x[:, 2] - HIGH, 18.0 - x[:, 0]), x[:, 2]), steps)
    random = np.random.default_rng(7)
    own = drawn_rig(random, KNOWN)
    image = as_image(position + 0.1 * random.normal(size=position.shape), steps, own.rig)
    write_points(folder / "step.npz", image)
    write_rig(folder / "rig.json", own)
    return folder


def click(x: float, z: float, **what: Any) -> Click:
    return Click(**{"kind": "plane", "place": at(x, Y, z), "radius": 6.0, **what})


def test_two_clicks_are_two_features_and_what_is_between_them() -> None:
    part = part_of_clicks([click(0.0, 0.0), click(30.0, HIGH, kind="ball", measured_from=0)], "step")
    assert [each.name for each in part.features] == ["plane 1", "ball 2"]
    of = {each.name: each.of for each in part.dimensions}
    assert of == {
        "plane 1, flatness": ("plane 1",),
        "ball 2, diameter": ("ball 2",),
        "plane 1 to ball 2, distance": ("plane 1", "ball 2"),
    }
    part = part_of_clicks([click(0.0, 0.0), click(30.0, HIGH, grow=True), click(9.0, 0.0, measured_from=1)])
    assert [each.name for each in part.dimensions][2:] == [
        "plane 3, flatness",
        "plane 2 to plane 3, distance",
        "plane 2 to plane 3, angle",
    ]


@pytest.mark.parametrize(
    ("wrong", "says"),
    [
        ({"kind": "surface"}, '"surface" cannot be clicked: choose plane, ball'),
        ({"radius": 0.0}, "a radius of 0 mm holds no points"),
        ({"radius": float("nan")}, "a radius of nan mm holds no points"),
        ({"place": (0.0, float("inf"), 0.0)}, "plane 2: its place is not finite"),
        ({"measured_from": 1}, "plane 2 is measured from click 1: name one before it"),
        ({"measured_from": -1}, "plane 2 is measured from click -1: name one before it"),
    ],
)
def test_clicks_that_are_none(wrong: dict[str, Any], says: str) -> None:
    with pytest.raises(InputError, match=re.escape(says)):
        part_of_clicks([click(0.0, 0.0), click(30.0, HIGH, **wrong)])


def test_a_part_is_written_as_it_is_read(tmp_path: Path) -> None:
    (tmp_path / "true.stl").touch()
    features = (
        Feature("low", "plane", Region((1.5, -2.0, 300.0), None, 8.0), grow=True),
        Feature("high", "plane", Region((1.5, -2.0, 300.0), (2.5, 0.25, 310.0))),
        Feature("edge", "edge", of=("low", "high")),
        Feature("cut", "section", None, point=(1.0, 2.0, 3.0), normal=(0.0, 0.6, -0.8)),
        Feature("round", "circle", Region((1.0, 2.0, 3.0), None, 4.0), of=("cut",)),
        Feature("all", "surface", Region((1.0, 2.0, 3.0), None, 4.0)),
    )
    dimensions = (
        Dimension("far", "distance", ("low", "high"), 4.0, (-0.1, 0.2)),
        Dimension("flat", "flatness", ("low",), 0.0, (0.0, 0.05)),
        Dimension("turn", "angle", ("low", "edge"), 90.0),
        Dimension("whole", "profile", ("all",), 0.0, (0.0, 0.5), tmp_path / "true.stl", True),
    )
    part = Part(tmp_path / "part.toml", 'a "part"', features, dimensions)
    part.path.write_text(part_text(part))
    assert read_part(part.path) == part


def test_clicks_that_come_together(scanned: Path) -> None:
    """A double click is one feature; two faces clicked at once are two; undoing twice at once leaves none."""
    viser = pytest.importorskip("viser", reason="viser (extra viewer) is not installed")
    from jaxscan.cli.measure import read_surface
    from jaxscan.view.measuring import Measuring

    server = viser.ViserServer("127.0.0.1", 8431, verbose=False)
    try:
        panel = Measuring(
            server, lambda: read_surface(scanned / "step.npz", scanned / "rig.json")[0], np.zeros(3), 100.0, "step"
        )
        low, high = np.asarray(at(-10.0, Y, 0.0)), np.asarray(at(35.0, Y, HIGH))

        def together(*calls: Any) -> str:
            threads = [threading.Thread(target=call, daemon=True) for call in calls]
            for thread in threads:
                thread.start()
            for thread in threads:
                thread.join(timeout=120)
            return panel._words.content

        assert "plane 2" not in together(*(lambda: panel.clicked(low + 0.1, 6.0),) * 3)
        assert "clicked already" in panel._words.content
        said = together(lambda: panel.clicked(high, 6.0), lambda: panel.clicked(low, 5.0))
        assert "plane 3" in said
        assert "plane 4" not in said
        assert "plane 1" not in together(*(lambda: panel._undone(None),) * 3)
    finally:
        server.stop()


# What the browser and its library open and leave to the collector is theirs.
@pytest.mark.filterwarnings("ignore::ResourceWarning", "ignore::pytest.PytestUnraisableExceptionWarning")
@pytest.mark.filterwarnings("ignore::DeprecationWarning")
def test_two_faces_in_a_browser(scanned: Path, tmp_path: Path) -> None:
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    pytest.importorskip("viser", reason="viser (extra viewer) is not installed")
    if not CHROMIUM:
        pytest.skip("chromium is not installed: no browser to look with")
    from jaxscan.cli.measure import read_surface
    from jaxscan.view.viewer import HOST, serve

    def read():
        return read_surface(scanned / "step.npz", scanned / "rig.json")[0]

    shown = view_data(scanned / "step.npz")
    server = serve(shown, 8331, read, name="step")
    middle = (shown.points.min(axis=0) + shown.points.max(axis=0)) / 2.0
    try:
        with api.sync_playwright() as play:
            flags = ["--no-sandbox", "--use-angle=swiftshader", "--enable-unsafe-swiftshader"]
            browser = play.chromium.launch(executable_path=CHROMIUM, args=flags)
            page = browser.new_page(viewport={"width": 900, "height": 600})
            page.set_default_timeout(120_000)
            page.goto(f"http://{HOST}:{server.get_port()}")
            page.wait_for_function("document.body.innerText.includes('Click a face')")

            def press(x: float, z: float, words: str) -> None:
                camera = next(iter(server.get_clients().values())).camera
                seen = np.asarray(at(x, Y, z)) - middle - camera.position
                w, *xyz = camera.wxyz
                a, b, c = Rotation.from_quat([*xyz, w]).inv().apply(seen)
                focal = 0.5 * 600 / np.tan(camera.fov / 2)
                # The first click may come before the surface can be hit; one that is only late must not be made again,
                # for it would be taken after what is clicked next.
                for _ in range(5):
                    page.mouse.click(450 + focal * a / c, 300 + focal * b / c)
                    with contextlib.suppress(api.TimeoutError):
                        page.wait_for_function(f"document.body.innerText.includes('{words}')", timeout=24_000)
                        return

            page.wait_for_timeout(2000)
            press(-10.0, 0.0, "plane 1, flatness")
            press(35.0, HIGH, "plane 1 to plane 2, distance")
            body = page.inner_text("body")
            with page.expect_download() as downloading:
                page.get_by_role("button", name="save part.toml").click()
            downloading.value.save_as(tmp_path / "part.toml")
            page.get_by_role("button", name="undo the last").click()
            page.wait_for_function(
                "document.body.innerText.includes('plane 1, flatness') && !document.body.innerText.includes('plane 2')"
            )
            browser.close()
    finally:
        server.stop()
    said = re.search(r"plane 1 to plane 2, distance\s+([\d.]+) ± ([\d.]+) mm", body)
    assert said, body
    value, uncertainty = map(float, said.groups())
    assert abs(value - HIGH) < 2 * uncertainty < 0.5
    assert re.search(r"plane 1 to plane 2, angle\s+[\d.]+ \([\d.]+ to [\d.]+\) °", body)
    # What was saved measures the same.
    part = read_part(tmp_path / "part.toml")
    again = {each.dimension.name: each for each in measure(read(), part).dimensions}["plane 1 to plane 2, distance"]
    assert again.value == pytest.approx(value, abs=1e-3)
