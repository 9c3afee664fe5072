"""The page and the JSON of a report: well formed, self-contained, and the same."""

import json
import os
import re
import shutil
from dataclasses import replace
from html.parser import HTMLParser
from pathlib import Path
from xml.etree import ElementTree

import numpy as np
import pytest

from jaxscan.calibration import calibrate
from jaxscan.calibration.diagnostics import diagnose
from jaxscan.errors import InputError
from jaxscan.view import report as reports
from jaxscan.view.calibration_report import calibration_report, compose
from jaxscan.view.report import Box, Figure, Report, Section, Table
from tests.calibration import sheets

CHROMIUM = shutil.which("chromium") or shutil.which("google-chrome") or os.environ.get("CHROMIUM", "")

SMALL = Report(
    kind="test",
    title="A <test> & more",
    verdict=Box("care", "Half good.", "Do the other half."),
    sections=(
        Section(
            "One",
            boxes=(Box("stop", "No."),),
            paragraphs=("Words < and >.",),
            items=("an item",),
            tables=(Table("numbers", ("a", "b"), (("1", "2"), ("3", "4"))),),
            figures=(Figure("dot", "a dot", b"\x89PNG"),),
        ),
    ),
    numbers={"x": np.array([1.0, np.nan]), "n": np.int64(3)},
)


class Texts(HTMLParser):
    """All that a reader sees, and every address that a page names."""

    def __init__(self):
        super().__init__()
        self.texts: list[str] = []
        self.addresses: list[str] = []

    def handle_data(self, data):
        if self.cdata_elem is None and data.strip():
            self.texts.append(data.strip())

    def handle_starttag(self, tag, attrs):
        assert tag not in ("script", "link", "iframe")
        self.addresses += [value for name, value in attrs if name in ("src", "href")]


def strings(value):
    """Every text in the sections of the JSON."""
    if isinstance(value, str):
        yield value
    elif isinstance(value, list):
        for each in value:
            yield from strings(each)
    elif isinstance(value, dict):
        for key, each in value.items():
            if key not in ("level", "name"):
                yield from strings(each)


def check(report: Report) -> None:
    page = reports.as_html(report)
    ElementTree.fromstring(page.removeprefix("<!DOCTYPE html>"))
    parser = Texts()
    parser.feed(page)
    inside = [address for address in parser.addresses if address.startswith("#")]
    assert all(address.startswith("data:image/png;base64,") for address in parser.addresses if address not in inside)
    # Contents: a link to each part, in their order.
    several = len(report.sections) > 1
    assert inside == [f"#part-{i}" for i in range(1, len(report.sections) + 1)] * several
    assert all(page.count(f'id="{address[1:]}"') == 1 for address in inside)
    assert "http:" not in page
    assert "https:" not in page
    values = json.loads(json.dumps(reports.as_dict(report), allow_nan=False))
    shown = set(parser.texts)
    assert {text for text in strings([values["verdict"], values["sections"]]) if text.strip()} <= shown
    written = {text for text in strings([values["title"], values["verdict"], values["sections"]])}
    assert shown - written == {parser.texts[-1]}  # the footer
    assert parser.texts[-1].startswith("Written by jaxscan")


def test_a_small_report_is_the_same_twice():
    check(SMALL)
    values = reports.as_dict(SMALL)
    assert values["format"] == "jaxscan-test/1"
    assert values["numbers"] == {"x": [1.0, None], "n": 3}
    assert values["sections"][0]["figures"] == [{"name": "dot", "caption": "a dot"}]


def test_contents_and_a_dark_page(tmp_path):
    """In a browser: each line of the contents leads to its part, and at night the page is dark."""
    api = pytest.importorskip("playwright.sync_api", reason="playwright is not installed")
    if not CHROMIUM:
        pytest.skip("chromium is not installed: no browser to look with")
    long = tuple(Section(f"Part {i}", paragraphs=("words",) * 40) for i in (1, 2, 3))
    reports.write_report_html(tmp_path / "r.html", replace(SMALL, sections=long))
    with api.sync_playwright() as play:
        browser = play.chromium.launch(executable_path=CHROMIUM, args=["--no-sandbox"])
        for scheme, dark in (("light", False), ("dark", True)):
            page = browser.new_page(color_scheme=scheme, viewport={"width": 390, "height": 700})
            page.goto(f"file://{tmp_path / 'r.html'}")
            page.get_by_role("link", name="Part 3").click()
            top = page.get_by_role("heading", name="Part 3").bounding_box()
            assert top is not None
            assert 0 <= top["y"] < 700
            ground, ink = page.locator("body").evaluate(
                "body => ['backgroundColor', 'color'].map(key => getComputedStyle(body)[key].match(/\\d+/g)"
                ".slice(0, 3).reduce((sum, n) => sum + Number(n), 0))"
            )
            assert (ground < ink) is dark
            assert abs(ground - ink) > 400
            assert page.locator("body").evaluate("body => body.scrollWidth") <= 390
        browser.close()


def test_the_report_of_a_calibration_is_the_same_twice(report):
    check(report)
    figures = [figure.name for section in report.sections for figure in section.figures]
    kinds = ("working-volume", "photographs", "scene", "residual-vectors", "histograms", "radius", "stripes", "stage")
    assert len(set(figures)) == len(figures)
    assert set(figures) >= {*kinds, "next-photographs", "agreement-0", "ladder", "coverage"}


@pytest.mark.long
@pytest.mark.parametrize(
    ("lens", "hold"), [("brown", ()), ("rational", tuple(f"camera.radial.{i}" for i in (3, 4, 5)))]
)
def test_the_report_of_a_lens_with_more_terms_than_the_photographs_support(session, lens, hold):
    pytest.importorskip("matplotlib", reason="the extra plots is not installed")
    report, judged = calibration_report(calibrate(session, lens=lens, hold=hold))
    check(report)
    assert any(f'The lens "{lens}" is richer than the photographs support' in box.statement for box in judged.warnings)
    parameters, lenses = (
        next(table for s in report.sections for table in s.tables if table.columns[0] == column)
        for column in ("parameter", "lens")
    )
    held = tuple(row[0] for row in parameters.rows if row[2] == "held")
    assert [row[0] for row in parameters.rows[4:7]] == [f"camera.radial.{i}" for i in range(3)]
    assert held == hold
    assert {row[0] for row in lenses.rows} >= {"none", "radial1", lens}


def test_the_json_has_the_pose_of_each_board_with_its_covariance(report, calibration):
    boards = json.loads(json.dumps(reports.as_dict(report)))["numbers"]["boards"]
    assert [board["staged"] for board in boards] == [False] * 11 + [True]
    assert [board["name"] for board in boards[:-1]] == [fit.name for fit in calibration.fits]
    for i, board in enumerate(boards[:-1]):
        covariance = board["covariance"]
        sigma = np.sqrt(np.diagonal(covariance["matrix"]))[covariance["names"].index("board.translation.2")]
        assert sigma == calibration.board_covariances[i].sigma("board.translation.2")
        assert 200 < board["translation_mm"][2] < 600


def test_the_json_has_the_shapes_of_boards_and_what_speaks_for_others(report):
    """The session's boards bulge, and its sheet is curved and was taken as flat."""
    seen = sheets.session(2, sheets.cone(0.3), board_mm=(0.3, -0.2))
    result = calibrate(seen, board_shape="bend")
    composed = compose(result, diagnose(result, thorough=False), (), report.numbers["next_best_views"])[0]
    numbers = reports.plain(composed.numbers)
    assert numbers["board_shape"]["board_shape"] == "bend"
    assert numbers["board_shape"]["board_bent_mm"] == result.board_bent_by()[0]
    assert numbers["board_flatness"]["bent_mm"] == pytest.approx(0.5, abs=0.05)
    (curve,) = numbers["sheet_curves"]
    assert abs(curve["curve_mm"]) == pytest.approx(0.3, abs=5 * curve["sigma_mm"])
    own = np.array([board["bulges_mm"] for board in numbers["boards"]])
    np.testing.assert_array_equal(own, np.asarray(result.system.bends(0)))
    assert report.numbers["board_shape"] == {}
    assert {board.bulges_mm for board in report.numbers["boards"]} == {None}
    (rig,) = (section for section in composed.sections if section.title == "The rig")
    assert any(paragraph.startswith("The board is bent by 0.") for paragraph in rig.paragraphs)


def test_the_report_says_how_far_a_sensor_is_tilted_and_a_sheet_curved(report):
    """In degrees and mm over 200 mm; the parameters are radians and mm of a formula, and their table said px."""
    seen = sheets.session(2, sheets.cone(0.3))
    result = calibrate(seen, light="bowed", tilted=True)
    composed = compose(result, diagnose(result, thorough=False), (), report.numbers["next_best_views"])[0]
    (rig,) = (section for section in composed.sections if section.title == "The rig")
    said = " ".join(rig.paragraphs)
    assert re.search(r"The sensor is tilted by \d\.\d\d° against the lens\.", said)
    assert re.search(r"The sheet of light is curved by 0\.\d+ ± 0\.\d+ mm over 200 mm in the middle", said)
    assert "of a tilt: radians; of a bow: mm" in rig.tables[0].caption


def test_files_are_whole_or_not_there(tmp_path: Path):
    reports.write_report_html(tmp_path / "report.html", SMALL)
    reports.write_report_json(tmp_path / "report.json", SMALL)
    assert (tmp_path / "report.html").read_text().startswith("<!DOCTYPE html>")
    assert json.loads((tmp_path / "report.json").read_text())["title"] == SMALL.title
    with pytest.raises(InputError):
        reports.write_report_html(tmp_path / "none" / "report.html", SMALL)
