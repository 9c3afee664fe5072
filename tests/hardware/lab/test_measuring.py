"""Faces of a project's points, clicked in a real browser: their distance, and a part.toml that measures it again."""

import re
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest
from playwright.sync_api import Browser, expect
from serving import VIEWER, Served, serve
from test_pages import browser, sign_in

import jaxscan
from jaxscan.cli.compiled import keep_compiled
from jaxscan.files.part_file import read_part
from jaxscan.images import write_image
from jaxscan.measurement.measure import measure
from jaxscan.rig.rig import parameter_names

__all__ = ["browser"]

ROWS, COLUMNS, FRAMES, APART = 64, 80, 24, 500
CAMERA = jaxscan.Camera.create((COLUMNS, ROWS), (60.0, 60.0), (39.5, 31.5))
RIG = jaxscan.Rig(
    CAMERA, (jaxscan.LightPlane.create((0.0, -1 / 250.0, 0.003)),), jaxscan.Linear.create((0.0, 0.009, 0.0))
)
# Where the stripe is in the left half and in the right one.
LOW, HIGH = 44.0, 40.0


def known() -> jaxscan.RigFile:
    names = tuple(parameter_names(RIG))
    return jaxscan.RigFile(RIG, jaxscan.Covariance(names, np.diag(np.full(len(names), 1e-12))))


def write_scan(folder: Path) -> None:
    """Photographs of a step, which runs along the stage's way."""
    (folder / "frames").mkdir(parents=True)
    random = np.random.default_rng(4)
    names = []
    for frame in range(FRAMES):
        rows = np.where(np.arange(COLUMNS) < COLUMNS // 2, LOW, HIGH) + 0.03 * random.normal(size=COLUMNS)
        image = np.full((ROWS, COLUMNS, 3), 20, np.uint8)
        image[..., 0] += (200 * np.exp(-((np.arange(ROWS)[:, None] - rows) ** 2) / 8)).astype(np.uint8)
        names.append(f"frames/{frame:02}.png")
        write_image(folder / names[-1], image)
    steps = [APART * frame for frame in range(FRAMES)]
    (folder / "scan.toml").write_text(f"[scan]\nframes = {names}\nsteps = {steps}\n".replace("'", '"'))


@pytest.fixture(scope="module")
def lab(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Served]:
    """For all tests: the process that makes its points takes seconds to begin."""
    keep_compiled()
    served = serve(tmp_path_factory.mktemp("measuring") / "lab", lease_s=20.0, rig=known())
    write_scan(served.lab.projects.path("step"))
    yield served
    served.end()


def seen(points: np.ndarray, place: np.ndarray, width: int = 800, height: int = 480) -> tuple[float, float]:
    """Where the page draws a place at first, as parts of the canvas."""
    low, high = points.min(axis=0), points.max(axis=0)
    extent, (dx, dy, dz) = high - low, place - (low + high) / 2
    size = 0.95 * min(width, height) / np.linalg.norm(1.1 * extent)
    cy, sy, cp, sp = np.cos(0.5), np.sin(0.5), np.cos(0.9), np.sin(0.9)
    return 0.5 + size * (cy * dx - sy * dy) / width, 0.5 + size * (cp * (sy * dx + cy * dy) + sp * dz) / height


def test_two_faces(browser: Browser, lab: Served, tmp_path: Path) -> None:
    page = sign_in(browser, lab, VIEWER)
    page.get_by_role("link", name="Projects").click()
    page.get_by_role("link", name="Measure").click()
    expect(page.locator("#waiting")).to_be_hidden(timeout=200_000)
    answer = lab.program(VIEWER).get("/api/projects/step/points")
    points = np.frombuffer(answer.content, "<f4").reshape(-1, 3).astype(float)
    page.fill("#radius", "20")
    page.get_by_label("the whole face").check()
    canvas = page.locator("#points")
    box = canvas.bounding_box()
    assert box is not None
    halves = [points[points[:, 0] < -5], points[points[:, 0] > 5]]
    for number, half in enumerate(halves, 1):
        middle = half[np.linalg.norm(half - half.mean(axis=0), axis=1).argmin()]
        x, y = seen(points, middle)
        canvas.click(position={"x": x * box["width"], "y": y * box["height"]})
        expect(page.locator("#rows")).to_contain_text(f"plane {number}, flatness")
    row = page.locator("#rows tr", has_text="plane 1 to plane 2, distance").inner_text()
    value, uncertainty = map(float, re.findall(r"([\d.]+) ± ([\d.]+) mm", row)[0])
    assert 0 < uncertainty < 0.5
    normal = np.linalg.svd(halves[0] - halves[0].mean(axis=0), full_matrices=False)[2][2]
    assert abs(value - abs(normal @ (halves[1].mean(axis=0) - halves[0].mean(axis=0)))) < 3 * uncertainty
    with page.expect_download() as downloading:
        page.get_by_role("button", name="Save part.toml").click()
    downloading.value.save_as(tmp_path / "part.toml")
    part = read_part(tmp_path / "part.toml")
    # A click where nothing is, and a drag, measure nothing.
    canvas.click(position={"x": 3, "y": 3})
    expect(page.locator("#rows")).not_to_contain_text("plane 3")
    page.locator("#kind").select_option("ball")
    page.fill("#radius", "0.02")
    canvas.click(position={"x": x * box["width"], "y": y * box["height"]})
    expect(page.locator("#said")).to_contain_text("20 or more are needed")
    page.get_by_role("button", name="Undo the last").click()
    expect(page.locator("#rows")).not_to_contain_text("plane 2")
    page.context.close()
    # What was saved measures the same by itself, on the range image that was clicked on.
    (image,) = map(jaxscan.read_range_image, (lab.lab.projects.path("step").parents[1] / "clouds").glob("step.*.npz"))
    again = measure(jaxscan.scanned_image(image, known()), part)
    found = next(each for each in again.dimensions if each.dimension.kind == "distance")
    assert found.value == pytest.approx(value, abs=0.02)


def test_bad_clicks(lab: Served) -> None:
    program = lab.program(VIEWER)
    face = {"kind": "plane", "place": [0, 0, 300], "radius": 5.0}

    def said(status: int, project: str = "step", **what: object) -> str:
        answer = program.post(f"/api/projects/{project}/measure", json={"faces": [face | what]}, timeout=200)
        assert answer.status_code == status, answer.text
        return answer.text

    assert "there is no project cup" in said(404, "cup")
    assert "place" in said(422, place=[0, 0])
    assert "radius" in said(422, radius=0)
    assert "kind" in said(422, kind="line")
    assert "measured_from" in said(422, measured_from=-1)
    assert "name one before it" in said(409, measured_from=3)
    assert "no point lies in its region" in said(200, place=[0, 0, 99999])
    lab.lab.projects.use(None)
    try:
        assert "no rig is in use" in said(409)
    finally:
        lab.lab.projects.use(known())
