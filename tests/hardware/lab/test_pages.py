"""The pages in a real browser: a whole scan, as people do it; and a browser that dies."""

import os
import re
import shutil
import signal
import subprocess
import time
import zipfile
from collections.abc import Iterator
from pathlib import Path
from uuid import uuid4

import pytest
from playwright.sync_api import Browser, BrowserType, Page, expect, sync_playwright
from serving import ADMINISTRATOR, LEASE_S, OPERATOR, PASSWORD, VIEWER, Served, Witness, serve, until

from hardware.devices import ScannerSettings, open_scanner
from jaxscan.cli.compiled import keep_compiled
from jaxscan.files.scan import read_scan
from jaxscan.files.session import read_session

LATEST_MS = 60_000


def launch(chromium: BrowserType, *flags: str) -> Browser:
    """Debian's Chromium, or whatever is called so."""
    names = ("chromium", "chromium-browser", "google-chrome")
    path = next(filter(None, map(shutil.which, names)), None)
    if path is None:
        pytest.skip(f"no browser: none of {', '.join(names)} is on the path")
    return chromium.launch(executable_path=path, args=["--no-sandbox", *flags])


@pytest.fixture(scope="module")
def browser() -> Iterator[Browser]:
    """One browser for all tests; each of them has contexts of its own."""
    expect.set_options(timeout=LATEST_MS)
    with sync_playwright() as playwright:
        started = launch(playwright.chromium)
        yield started
        started.close()


@pytest.fixture
def lab(tmp_path: Path) -> Iterator[Served]:
    """A lab whose lease outlasts a browser on a busy machine, and whose photographs take a moment."""
    served = serve(tmp_path / "lab", lease_s=20.0)
    served.camera.exposure_s = 0.05
    yield served
    served.end()


def sign_in(browser: Browser, lab: Served, name: str, width: int = 1280, scheme: str = "light") -> Page:
    """A page of somebody who has typed name, password and Enter; whatever goes wrong in it fails the test."""
    context = browser.new_context(viewport={"width": width, "height": 800}, color_scheme=scheme)
    context.set_default_timeout(LATEST_MS)
    page = context.new_page()
    page.on("pageerror", lambda error: pytest.fail(str(error)))
    page.on("request", lambda request: request.url.startswith((lab.url, "blob:")) or pytest.fail(request.url))
    page.goto(lab.url)
    expect(page.get_by_label("Name")).to_be_focused()
    page.keyboard.type(name)
    page.keyboard.press("Tab")
    page.keyboard.type(PASSWORD)
    page.keyboard.press("Enter")
    page.wait_for_url(lab.url)
    return page


def test_a_whole_scan(browser: Browser, lab: Served, tmp_path: Path):
    page, watcher = sign_in(browser, lab, OPERATOR), sign_in(browser, lab, VIEWER, 390, "dark")
    expect(watcher.locator("#operator")).to_have_text("The scanner is free")
    page.get_by_role("button", name="Operate").click()
    expect(page.locator("#operator")).to_have_text("You operate the scanner")
    expect(watcher.locator("#operator")).to_have_text(f"{OPERATOR} operates. Here you watch")
    expect(watcher.locator("#take-over")).to_be_hidden()
    expect(watcher.locator("#stop")).to_be_hidden()
    expect(watcher.get_by_role("button", name="Step and shoot")).to_be_disabled()

    page.get_by_role("button", name="Reset motor").click()
    expect(page.locator("#place")).to_have_text("0 steps")
    # The slider by keyboard, then a photograph there. The place is said a moment before the controls are free again.
    expect(page.locator("#slider")).to_be_enabled()
    page.locator("#slider").focus()
    for _ in range(3):
        page.keyboard.press("ArrowRight")
    expect(page.locator("#step")).to_have_value("300")
    page.fill("#project", "cup")
    page.get_by_role("button", name="Step and shoot").click()
    expect(page.locator("#place")).to_have_text("300 steps")
    expect(page.locator("#picture")).to_be_visible()
    expect(page.locator("#no-picture")).to_be_hidden()

    # Long enough for a hand to come in between.
    lab.camera.exposure_s = 0.5
    page.fill("[name=frames]", "12")
    page.fill("[name=apart]", "1000")
    page.fill("[name=first]", "1000")
    page.locator("[name=first]").press("Enter")
    expect(page.locator("#job-words")).to_contain_text(re.compile("^[2-9] of 12"))
    page.get_by_role("button", name="Pause").click()
    expect(watcher.locator("#job-state")).to_have_text("paused")
    expect(watcher.locator("#resume")).to_be_hidden()
    lab.camera.exposure_s = 0.0
    page.get_by_role("button", name="Go on").click()
    expect(watcher.locator("#job-words")).to_contain_text("12 of 12 photographs")
    expect(page.locator("#job-state")).to_have_text("done")

    page.get_by_role("link", name="Projects").click()
    with page.expect_download() as downloading:
        page.get_by_role("link", name="Scan (zip)").click()
    with zipfile.ZipFile(downloading.value.path()) as archive:
        archive.extractall(tmp_path / "fetched")
    assert read_scan(tmp_path / "fetched" / "cup").axes["stage"] == (300, *range(1000, 13000, 1000))
    page.get_by_role("button", name="Sign out").click()
    expect(page.get_by_label("Password")).to_be_visible()
    expect(watcher.locator("#operator")).to_have_text("The scanner is free")
    for tab in (page, watcher):
        tab.context.close()


def test_a_scan_around_the_turntable(browser: Browser, tmp_path: Path):
    """The axis is chosen, and the stage stands where the page says; shifted, it is gone around once more."""
    lab = serve(tmp_path / "lab", lease_s=20.0, turntable=True)
    page, watcher = sign_in(browser, lab, OPERATOR), sign_in(browser, lab, VIEWER, 390)
    page.get_by_role("button", name="Operate").click()
    page.get_by_role("button", name="Reset motor").click()
    expect(page.locator("#place")).to_have_text("0 steps")
    page.locator("#axis").select_option("turntable")
    expect(page.locator("#slider")).to_have_attribute("max", "3200")
    page.fill("#step", "800")
    page.get_by_role("button", name="Go there").click()
    expect(page.locator("#place")).to_have_text("800 steps")
    expect(page.locator("#job-title")).to_have_text("Move to 800 (turntable)")
    page.fill("#project", "owl")
    expect(page.locator("[data-at=stage]")).to_be_hidden()
    page.locator("[name=axis]").select_option("turntable")
    stage = page.locator("[data-at=stage] input")
    # It stands where it stood, until something else is said.
    expect(stage).to_have_value("0")
    expect(page.locator("[data-at=turntable]")).to_be_hidden()
    expect(page.locator("[name=full_turn]")).to_be_checked()
    expect(page.locator("[name=apart]")).to_be_disabled()
    lab.camera.exposure_s = 0.3
    page.fill("[name=frames]", "8")
    stage.fill("5000")
    page.get_by_role("button", name="Start").click()
    expect(page.locator("#job-words")).to_contain_text(re.compile("^[2-6] of 8"))
    page.get_by_role("button", name="Pause").click()
    expect(watcher.locator("#job-state")).to_have_text("paused")
    page.get_by_role("button", name="Abort").click()
    expect(page.locator("#job-state")).to_have_text("aborted")
    lab.camera.exposure_s = 0.0
    page.get_by_role("button", name="Go on").click()
    expect(watcher.locator("#job-words")).to_contain_text("8 of 8 photographs")
    expect(page.locator("#job-state")).to_have_text("done")
    # Four more with the stage elsewhere, each a quarter of a turn on, in the same project.
    page.locator("[name=full_turn]").uncheck()
    page.fill("[name=frames]", "4")
    page.fill("[name=apart]", "800")
    stage.fill("9000")
    page.get_by_role("button", name="Start").click()
    expect(page.locator("#job-words")).to_contain_text("4 of 4 photographs")
    page.fill("[name=frames]", "9")
    page.get_by_role("button", name="Start").click()
    expect(page.locator("#said")).to_contain_text("2.00 turns")
    scan = lab.lab.projects.scan("owl")
    assert scan.axes == {
        "turntable": (*range(0, 3200, 400), *range(0, 3200, 800)),
        "stage": (5000,) * 8 + (9000,) * 4,
    }
    for tab in (page, watcher):
        tab.context.close()
    lab.end()


@pytest.mark.timeout(900)
def test_a_guided_calibration_session(browser: Browser, tmp_path: Path):
    """On the simulated scanner: somebody holds its board in another pose whenever the guide asks for one."""
    keep_compiled()
    # Live pictures are drawn, and looked at for the board: with more of them the machine does nothing else.
    lab = serve(tmp_path / "lab", profiles=True, live_s=1.0, scanner=lambda: open_scanner(ScannerSettings()))
    page, watcher = sign_in(browser, lab, OPERATOR), sign_in(browser, lab, VIEWER, 390, "dark")
    page.get_by_role("button", name="Operate").click()
    for name, value in {"views": 4, "stage_frames": 2, "stage_apart": 16000}.items():
        page.fill(f"#calibration [name={name}]", str(value))
    page.get_by_role("button", name="Begin").click()
    expect(page.locator("#wish")).to_contain_text("fills the middle of the image")
    take = page.get_by_role("button", name="Take")
    expect(take).to_be_focused()
    expect(watcher.locator("#wish")).to_contain_text("fills the middle of the image")
    expect(watcher.locator("#take-view")).to_be_hidden()
    for view in range(1, 4):
        # The first time JAX compiles what draws and what refines.
        expect(page.locator("#covered")).to_contain_text("board seen", timeout=4 * LATEST_MS)
        page.keyboard.press("Enter")
        expect(page.locator("#job-words")).to_contain_text(f"{view} of 6 photographs · view {view}")
        expect(take).to_be_focused()
    expect(page.locator("#covered")).not_to_contain_text("corners in 0 of 12")
    expect(page.locator("#picture")).to_be_visible()
    # Three are enough; the stage's sequence goes by itself.
    page.get_by_role("button", name="Enough poses").click()
    expect(page.locator("#wish")).to_contain_text("fix the board on the stage")
    page.get_by_role("button", name="Begin the stage's sequence").click()
    expect(page.locator("#job-state")).to_have_text("done")
    expect(watcher.locator("#wish")).to_be_hidden()
    # Its rig, solved by the server and taken into use, makes points of the next photographs.
    expect(page.locator("#rig-name")).to_have_text("none")
    expect(page.locator("#use")).to_be_disabled()
    expect(page.locator("#cloud-card")).to_be_hidden()
    expect(watcher.locator("#solve")).to_be_disabled()
    page.locator("#session").select_option("calibration-1")
    page.get_by_role("button", name="Calibrate").click()
    expect(page.locator("#solving")).to_contain_text("calibrating calibration-1")
    expect(page.locator("#said")).to_contain_text("calibration-1 is calibrated", timeout=10 * LATEST_MS)
    expect(page.locator("#verdict")).to_contain_text("what limits it")
    expect(page.locator("#rig-name")).to_have_text("none")
    page.get_by_role("button", name="Use this rig").click()
    expect(watcher.locator("#rig-name")).to_have_text("calibration-1")
    expect(page.locator("#use")).to_be_disabled()
    expect(page.locator("#no-rig")).to_be_hidden()
    expect(page.locator("#no-cloud")).to_be_visible()
    page.fill("#step", "20000")
    page.get_by_role("button", name="Step and shoot").click()
    expect(page.locator("#cloud-of")).to_have_text(re.compile(r"^scan-1: \d{2,}"), timeout=5 * LATEST_MS)
    expect(page.locator("#no-cloud")).to_be_hidden()
    page.get_by_role("link", name="Projects").click()
    with page.expect_download() as downloading:
        page.get_by_role("link", name="Session (zip)").click()
    with zipfile.ZipFile(downloading.value.path()) as archive:
        archive.extractall(tmp_path / "fetched")
    session = read_session(tmp_path / "fetched" / "calibration-1")
    assert len(session.views.boards) == 3
    assert session.stage is not None
    assert session.stage.steps == (0, 16000)
    for tab in (page, watcher):
        tab.context.close()
    lab.end()


def test_narrow_screens_and_the_keyboard(browser: Browser, lab: Served):
    page = sign_in(browser, lab, ADMINISTRATOR, 360)
    for path in ("", "projects", "account", "api"):
        page.goto(lab.url + path)
        assert page.locator("body").evaluate("body => body.scrollWidth") <= 360
    page.goto(lab.url)
    for _ in range(3):
        page.keyboard.press("Tab")
    assert page.locator(":focus").get_attribute("href") == "/"
    page.get_by_role("button", name="Operate").press("Enter")
    expect(page.locator("#operator")).to_have_text("You operate the scanner")
    page.keyboard.press("Escape")
    expect(page.locator("#said")).to_contain_text("stopped; the stage is homed")
    page.goto(lab.url + "account")
    page.get_by_label("For").fill("nightly scans")
    page.get_by_role("button", name="Make a token").click()
    token = page.locator("#token")
    expect(token).to_have_text(re.compile(r"^\S{40,}$"))
    assert lab.client(Authorization=f"Bearer {token.inner_text()}").get("/api/me").json()["name"] == ADMINISTRATOR
    page.context.close()


def test_controls_rest_while_a_job_runs(browser: Browser, lab: Served):
    page = sign_in(browser, lab, OPERATOR)
    for what in ("#no-picture", "#no-profile"):
        expect(page.locator(what)).to_contain_text("appear")
    page.get_by_role("button", name="Operate").click()
    start = page.get_by_role("button", name="Start")
    expect(start).to_be_enabled()
    lab.camera.exposure_s = 0.5
    page.fill("[name=frames]", "8")
    page.fill("[name=apart]", "500")
    start.press("Enter")
    expect(page.locator("#job-state")).to_have_text("running")
    for name in ("Start", "Go there", "Reset motor", "Step and shoot", "Begin", "Calibrate"):
        expect(page.get_by_role("button", name=name, exact=True)).to_be_disabled()
    expect(page.get_by_label("Photographs", exact=True)).to_be_disabled()
    # What concerns the job, and what may be changed at any time, do not rest.
    for name in ("Stop Esc", "Pause", "Abort"):
        expect(page.get_by_role("button", name=name)).to_be_enabled()
    expect(page.get_by_label("shown while nothing else is done")).to_be_enabled()
    page.get_by_role("button", name="Pause").click()
    expect(page.locator("#job-state")).to_have_text("paused")
    expect(start).to_be_disabled()
    lab.camera.exposure_s = 0.0
    page.get_by_role("button", name="Abort").click()
    expect(start).to_be_enabled()
    page.context.close()


def test_the_keyboard_is_where_it_was_once_a_job_is_done(browser: Browser, lab: Served):
    page = sign_in(browser, lab, OPERATOR)
    page.get_by_role("button", name="Operate").click()
    lab.camera.exposure_s = 1.0
    shoot = page.get_by_role("button", name="Step and shoot")
    # A key pressed before the seat is given would go nowhere.
    expect(shoot).to_be_enabled()
    shoot.press("Enter")
    expect(shoot).to_be_disabled()
    expect(shoot).to_be_enabled()
    expect(shoot).to_be_focused()
    page.context.close()


def test_a_phone_has_the_controls_first_and_the_night_is_dark(browser: Browser, lab: Served):
    phone, desk = sign_in(browser, lab, VIEWER, 390, "dark"), sign_in(browser, lab, VIEWER)
    for page, first, second in ((phone, ".controls", ".views"), (desk, ".views", ".views")):
        tops = [page.locator(part).bounding_box() for part in (".status", first, second)]
        assert all(tops)
        assert tops[0]["y"] < tops[1]["y"] <= tops[2]["y"]
    left, right = (desk.locator(part).bounding_box() for part in (".views", ".controls"))
    assert left["x"] < right["x"]
    assert abs(left["y"] - right["y"]) < 2
    light = "element => getComputedStyle(element).backgroundColor.match(/\\d+/g).reduce((sum, n) => sum + Number(n), 0)"
    assert phone.locator("body").evaluate(light) < 150
    assert desk.locator("body").evaluate(light) > 600
    for page in (phone, desk):
        page.context.close()


def test_a_refusal_is_said_on_the_page(browser: Browser, lab: Served):
    page = sign_in(browser, lab, OPERATOR)
    page.get_by_role("button", name="Operate").click()
    page.fill("#step", "20001")
    page.get_by_role("button", name="Go there").click()
    expect(page.locator("#said")).to_contain_text("the stage goes from 0 to 20000")
    page.fill("#project", "../etc")
    page.get_by_role("button", name="Step and shoot").click()
    expect(page.locator("#said")).to_contain_text("letters, digits, _ and -")
    page.context.close()


class Mortal:
    """A browser of its own, in a process that can be killed."""

    def __init__(self, browser: Browser):
        # What no other process has on its command line; the processes that serve this one name their type.
        mark = f"--mortal={uuid4()}"
        self.started = launch(browser.browser_type, mark)
        listed = subprocess.run(["ps", "-ww", "-eo", "pid=,ppid=,args="], capture_output=True, text=True, check=True)
        lines = [line.split(maxsplit=2) for line in listed.stdout.splitlines()]
        own = {int(pid): int(parent) for pid, parent, args in lines if mark in args and " --type=" not in args}
        # One that has just been forked still has its parent's command line.
        (self.pid,) = (pid for pid, parent in own.items() if parent not in own)

    def kill(self) -> None:
        """Kill it, with no time for a word."""
        os.kill(self.pid, signal.SIGKILL)
        self.killed_s = time.monotonic()
        until(self._gone)

    def _gone(self) -> bool:
        try:
            os.kill(self.pid, 0)
        except ProcessLookupError:
            return True
        return False


def test_a_browser_that_is_killed_in_mid_move(browser: Browser, tmp_path: Path):
    """The page keeps the lock for as long as it lives; then the motor stops as the lock is given up."""
    lab = serve(tmp_path / "lab", speed=4, lease_s=3 * LEASE_S)
    lab.stage.home()
    mortal, watcher = Mortal(browser), lab.program(VIEWER)
    page = sign_in(mortal.started, lab, OPERATOR)
    page.get_by_role("button", name="Operate").click()
    until(lambda: lab.lab.lock.holder)
    page.wait_for_timeout(3500 * LEASE_S)
    with Witness(lab) as witness:
        page.fill("#step", "20000")
        page.get_by_role("button", name="Go there").click()
        until(lambda: lab.moving)
        mortal.kill()
        assert watcher.post("/api/lock", json={}).status_code == 409
        until(lambda: watcher.get("/api/state").json()["operator"] is None)
        # The lease is looked after in twentieths of itself; the rest is for a machine with much to do.
        assert time.monotonic() - mortal.killed_s < 3 * LEASE_S + 2
        job = until(lambda: (job := watcher.get("/api/jobs").json()[0])["ended_s"] and job)
    assert (job["state"], job["message"]) == ("aborted", "stopped: its operator is gone")
    assert not lab.moving
    assert 0 < lab.stage.true_position() < 20000
    # The order to stand goes out as the lock is given up.
    assert witness.orphaned_s < 0.5
    assert watcher.post("/api/lock", json={}).status_code == 200
    lab.end()


def test_a_scan_outlives_the_browser_that_began_it(browser: Browser, tmp_path: Path):
    lab = serve(tmp_path / "lab", lease_s=3 * LEASE_S)
    lab.camera.exposure_s = 0.1
    mortal, watcher = Mortal(browser), lab.program(VIEWER)
    page = sign_in(mortal.started, lab, OPERATOR)
    page.get_by_role("button", name="Operate").click()
    page.fill("[name=frames]", "8")
    page.fill("[name=apart]", "1000")
    page.get_by_role("button", name="Start").click()
    with Witness(lab) as witness:
        until(lambda: lab.lab.projects.all() and lab.lab.projects.one("scan-1").frames)
        mortal.kill()
        assert watcher.post("/api/lock", json={}).status_code == 409
        until(lambda: watcher.get("/api/state").json()["operator"] is None)
    assert watcher.get("/api/jobs").json()[0]["state"] == "done"
    assert lab.lab.projects.one("scan-1").frames == 8
    assert witness.orphaned_s == 0
    lab.end()
