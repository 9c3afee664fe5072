"""A lab on a real server, on a loopback port, with a stage that is emulated and a camera that draws a stripe."""

import re
import threading
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import httpx
import numpy as np
from argon2 import PasswordHasher

from benchmarks.lab_tls import certificate
from hardware import Frame
from hardware.clock import PacedClock
from hardware.errors import CameraError
from hardware.lab.lab import Lab
from hardware.lab.server import Server, bind
from hardware.lab.worker import Habits
from hardware.scan import Devices
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel

PASSWORD = "correct horse battery"
ADMINISTRATOR, OPERATOR, VIEWER = "maria", "paul", "olga"
TRAVEL = Travel(last=20000)
TURNTABLE = Travel(last=3200, steps_per_turn=3200)
ROWS, COLUMNS = 64, 80
# Leases: one that a test waits for, one that does not end however busy the machine is.
LEASE_S, LONG_S = 1.0, 60.0


class StripeCamera:
    """Photographs a red stripe, the lower the further the stage is; none while the laser is off.

    Or whatever is held before it, `held`.
    """

    def __init__(self, stage: SimulatedStage, laser: SimulatedLaser):
        self.stage, self.laser = stage, laser
        self.exposure_s = 0.0
        self.broken = False
        self.taken = 0
        self.held: np.ndarray | None = None

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Nothing."""

    def expose(self, positions: Mapping[str, int]) -> Frame:
        if self.broken:
            raise CameraError("no photograph: check the camera's cable")
        time.sleep(self.exposure_s)
        self.taken += 1
        if self.held is not None:
            return Frame(self.held, positions, time.time(), 0.01)
        image = np.full((ROWS, COLUMNS, 3), 20, np.uint8)
        if self.laser.lit:
            center = 20 + 20 * self.stage.true_position() / TRAVEL.last + 3 * np.sin(np.arange(COLUMNS) / 12)
            image[..., 0] += (200 * np.exp(-((np.arange(ROWS)[:, None] - center) ** 2) / 8)).astype(np.uint8)
        return Frame(image, positions, time.time(), 0.01)

    def close(self) -> None:
        """Nothing."""


def make_stage(speed: float, travel: Travel = TRAVEL) -> SimulatedStage:
    """A stage that takes its time, or with a speed of 0 none."""
    stage = SimulatedStage(travel)
    if speed:
        stage.line.clock = stage.line.port.clock = PacedClock(speed)
    return stage


@dataclass
class Served:
    """A lab and its server."""

    lab: Lab
    url: str
    camera: StripeCamera
    server: Server
    end: Callable[[], None]
    clients: list[httpx.Client] = field(default_factory=list)

    def client(self, **headers: str) -> httpx.Client:
        """Somebody who has not signed in."""
        # Reading the world's certificates takes longer than most requests here, and the tests' own is not among them.
        client = httpx.Client(base_url=self.url, headers=headers, timeout=20, trust_env=False, verify=False)
        self.clients.append(client)
        return client

    def program(self, name: str) -> httpx.Client:
        """Somebody's program, with a token."""
        return self.client(Authorization=f"Bearer {self.lab.accounts.make_token_for(name)}")

    def browser(self, name: str, password: str = PASSWORD) -> httpx.Client:
        """Somebody who has signed in, as a browser does."""
        client = self.client()
        answer = sign_in(client, name, password)
        assert answer.status_code == 303, answer.text
        client.headers["X-CSRF-Token"] = csrf_of(client)
        return client

    @property
    def address(self) -> tuple[str, int]:
        """Host and port, for raw bytes."""
        url = httpx.URL(self.url)
        return url.host, url.port or 0

    @property
    def stage(self) -> SimulatedStage:
        """The stage that is connected."""
        return self.camera.stage

    @property
    def moving(self) -> bool:
        """Whether the motor turns."""
        return self.stage.line.port.axis.moving(self.stage.line.clock.now_s())


def tls_files(folder: Path) -> dict[str, Path]:
    """A certificate and its key, made in this folder, by the names that `serve` has for them."""
    return dict(zip(("cert", "key"), certificate(folder), strict=True))


class Witness:
    """Looks at motor and lock all the time."""

    def __init__(self, served: Served):
        self._served, self._ended = served, threading.Event()
        self.orphaned_s = 0.0
        self._thread = threading.Thread(target=self._look, daemon=True)

    def __enter__(self) -> "Witness":
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        self._thread.join()

    def _look(self) -> None:
        alone_since_s = None
        while not self._ended.wait(0.005):
            if self._served.lab.lock.holder is None and self._served.moving:
                alone_since_s = alone_since_s or time.monotonic()
                self.orphaned_s = max(self.orphaned_s, time.monotonic() - alone_since_s)
            else:
                alone_since_s = None


def sign_in(client: httpx.Client, name: str, password: str = PASSWORD) -> httpx.Response:
    """Fill in the form and send it."""
    form = re.search(r'name="form" value="([^"]+)"', client.get("/sign-in").text)
    assert form
    return client.post("/sign-in", data={"name": name, "password": password, "form": form[1]})


def csrf_of(client: httpx.Client) -> str:
    """The CSRF token in a page."""
    found = re.search(r'name="csrf" content="([^"]+)"', client.get("/account").text)
    assert found
    return found[1]


def serve(
    folder: Path,
    *,
    speed: float = 0,
    profiles: bool = False,
    cert: Path | None = None,
    key: Path | None = None,
    scanner: Callable[[], Devices] | None = None,
    turntable: bool = False,
    server: Mapping[str, Any] | None = None,
    **how: Any,
) -> Served:
    """Serve a lab until it is ended, with another scanner if need be; without profiles JAX compiles nothing.

    What is for the server itself is in `server`. A turntable, which its camera does not see, is connected again
    with the stage.
    """
    laser = SimulatedLaser()
    camera = StripeCamera(make_stage(speed), laser)
    travels = {"stage": TRAVEL, "turntable": TURNTABLE} if turntable else {"stage": TRAVEL}
    how = {"lease_s": LONG_S, "live_s": 0.05, **how}

    def connect() -> Devices:
        if not camera.stage.line.port.is_open:
            camera.stage = make_stage(speed)
        table = {"turntable": make_stage(speed, TURNTABLE)} if turntable else {}
        return Devices(camera, {"stage": camera.stage, **table}, laser)

    lab = Lab(folder, scanner or connect, Habits(travels), **how)
    lab.accounts._hasher = PasswordHasher(time_cost=1, memory_cost=64, parallelism=1)
    if not profiles:
        lab.gallery._measure = lambda *_: None
    for name in (ADMINISTRATOR, OPERATOR, VIEWER):
        if name not in {one.name for one in lab.accounts.everybody()}:
            lab.accounts.add(name, PASSWORD, name == ADMINISTRATOR)
    ready = threading.Event()
    listening = bind("127.0.0.1", 0, tls=False, insecure=False)
    serving = Server(lab, listening, cert, key, lambda url: ready.set(), **(server or {}))
    thread = threading.Thread(target=serving.serve_here, daemon=True)
    thread.start()
    assert ready.wait(10)

    def end() -> None:
        serving.should_exit = True
        thread.join(10)
        for client in served.clients:
            client.close()
        lab.close()

    served = Served(lab, serving.url, camera, serving, end)
    return served


def until(true: Callable[[], Any], within_s: float = 60.0) -> Any:
    """Wait for something; for long, for the machine may be busy."""
    end_s = time.monotonic() + within_s
    while not (found := true()):
        assert time.monotonic() < end_s, "it never came"
        time.sleep(0.01)
    return found


def job_of(client: httpx.Client, number: int) -> dict[str, Any]:
    """A job as it is now."""
    return client.get(f"/api/jobs/{number}").raise_for_status().json()


def ended(client: httpx.Client, answer: httpx.Response) -> dict[str, Any]:
    """A job that was ordered, once it has ended."""
    assert answer.status_code == 202, answer.text
    number = answer.json()["id"]
    return until(lambda: (job := job_of(client, number))["ended_s"] and job)


def scan(project: str, frames: int = 3, **how: Any) -> dict[str, Any]:
    """An order for a scan."""
    return {"kind": "scan", "project": project, "frames": frames, "apart": 1000, "settle_s": 0, **how}
