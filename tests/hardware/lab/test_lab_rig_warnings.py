"""What a lab says of its rig and its devices, on the page and in the state on a real server."""

import json
from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from markupsafe import escape
from serving import VIEWER, serve

from hardware.devices import ScannerSettings
from hardware.lab.gallery import Gallery
from hardware.lab.hub import Hub
from hardware.lab.reconstructor import _calibrate
from jaxscan import Camera, LightPlane, Linear, Rig, RigFile, read_rig, write_rig
from jaxscan.images import StripeSettings
from jaxscan.precision import as_numpy
from jaxscan.view.report import Box
from jaxscan.view.verdict import Verdict

WARNING = 'The light plane of laser "<b>left" does not fit the stripes that it was found from'
SENTENCE = "The rig's file warns: "


@pytest.mark.parametrize("warnings", [(), (WARNING,), (WARNING, "Another one")])
def test_everybody_reads_what_is_known_against_the_rig(tmp_path: Path, warnings: tuple[str, ...]):
    camera = Camera.create((80, 64), (100.0, 100.0), (39.5, 31.5))
    rig = as_numpy(Rig(camera, (LightPlane.create(np.array([0.0, 0.002, 0.003]), "<b>left"),)))
    served = serve(tmp_path / "lab", rig=RigFile(rig, None, {"warnings": list(warnings)} if warnings else {}))
    try:
        page = served.browser(VIEWER).get("/").raise_for_status().text
        state = served.program(VIEWER).get("/api/state").raise_for_status().json()
    finally:
        served.end()
    assert tuple(state["rig_warnings"]) == warnings
    assert page.count(SENTENCE) == len(warnings)
    for warning in warnings:
        assert f"{SENTENCE}{escape(warning)}." in page


def test_without_a_rig_there_is_none(tmp_path: Path):
    served = serve(tmp_path / "lab")
    try:
        assert SENTENCE not in served.browser(VIEWER).get("/").text
        assert served.program(VIEWER).get("/api/state").json()["rig_warnings"] == []
    finally:
        served.end()


def test_a_red_verdict_goes_into_the_file_of_the_labs_own_calibration(tmp_path: Path, monkeypatch: pytest.MonkeyPatch):
    content = RigFile(as_numpy(Rig(Camera.create((80, 64), (100.0, 100.0), (39.5, 31.5)))), None, {})
    boxes = (Box("stop", "The photographs are in another order.", "Sort them."), Box("care", "Few views."))
    judged = Verdict("stop", "Do not use this calibration yet.", "", "", boxes, False)

    def calibrated(paths: list[Path], output: Path) -> SimpleNamespace:
        write_rig(output, content)
        return SimpleNamespace(rig_file=lambda: content, rig=content.rig)

    monkeypatch.setattr("jaxscan.cli.calibrate.calibrate_session", calibrated)
    monkeypatch.setattr("jaxscan.view.verdict.verdict", lambda calibration: judged)
    said = _calibrate({"session": str(tmp_path / "session"), "to": str(tmp_path / "rig.json")})
    assert said[0] == judged.statement
    assert any("No axis was calibrated" in words for words in said)
    assert read_rig(tmp_path / "rig.json").warnings == (
        "The calibration was not to be used: The photographs are in another order",
    )


def test_a_rig_of_another_camera_or_axis_makes_no_points_and_it_is_said(tmp_path: Path):
    """Points of a rig of 80 x 64 pixels were shown for photographs of any size."""
    camera = Camera.create((80, 64), (100.0, 100.0), (39.5, 31.5))
    rig = as_numpy(Rig(camera, (LightPlane.create(np.array([0.0, 0.002, 0.003])),), Linear.create([0.0, 0.01, 0.0])))
    hub = Hub()
    gallery, said = Gallery(hub, StripeSettings("grey"), RigFile(rig)), []
    hub.publish = lambda kind, data: said.append(json.loads(data))
    try:
        for shape, place in (((128, 160), {"stage": 5}), ((64, 80), {"turntable": 5}), ((64, 80), {"stage": 5})):
            image = np.full(shape, 20, np.uint8)
            image[30:33] = [[200], [250], [200]]
            gallery._measure(image, tmp_path / "0000.png", place, 0)
    finally:
        gallery.close()
    assert said[0]["problem"].startswith(
        "no points: the photograph has 160 x 128 pixels, the rig was calibrated with 80 x 64"
    )
    assert said[1]["problem"] == "no points: the rig has no axis turntable: calibrate one that has"
    assert ["points" in each for each in said] == ["problem" not in each for each in said] == [False, False, True]
    assert len(said[2]["points"]) == 80


def test_the_page_says_what_is_simulated(tmp_path: Path):
    assert ScannerSettings().simulated == ("camera", "stage", "turntable", "laser")
    served = serve(tmp_path / "lab")
    try:
        client = served.browser(VIEWER)
        assert served.program(VIEWER).get("/api/state").json()["simulated"] == []
        assert "imulated" not in client.get("/").text
        for parts, says in (
            (("camera", "stage", "laser"), "The scanner is simulated: nothing moves or shines"),
            (("stage",), "Simulated: stage<"),
        ):
            served.lab.habits = replace(served.lab.habits, simulated=parts)
            assert says in client.get("/").text
    finally:
        served.end()
