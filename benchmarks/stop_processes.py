"""What the benchmark of Stop measures, in a process of its own: a server with a rig and projects without clouds."""

import json
import secrets
import signal
import sys
import time
from collections.abc import Mapping
from pathlib import Path
from typing import Final

import numpy as np

from hardware.clock import PacedClock
from hardware.frame import Frame
from hardware.lab.gate import raise_limit
from hardware.lab.lab import Lab
from hardware.lab.server import Server, bind
from hardware.lab.worker import Habits
from hardware.scan import Devices
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel
from jaxscan import Camera, LightPlane, Linear, Rig, RigFile
from jaxscan.images import write_image

_FASTER: Final = 8
_ROWS, _COLUMNS = 120, 160
_PHOTOGRAPHS = 4


def photograph(step: int) -> np.ndarray:
    """A stripe that depends on where the stage is alone."""
    random, rows = np.random.default_rng(step), np.arange(_ROWS)[:, None]
    image = random.integers(18, 26, (_ROWS, _COLUMNS, 3), np.uint8)
    center = 40 + step / 200 + 6 * np.sin(np.arange(_COLUMNS) / 20)
    image[..., 0] += (200 * np.exp(-((rows - center) ** 2) / 8)).astype(np.uint8)
    return image


class _Camera:
    """Photographs of a stripe, the same at the same place."""

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Nothing to set."""

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """The one of this place."""
        return Frame(photograph(positions.get("stage", 0)), positions, time.time(), 0.01)

    def close(self) -> None:
        """Nothing to do."""


def _serve(folder: Path, projects: int, tls: tuple[Path, Path] | None) -> None:
    """Serve until terminated; print the address and the tokens of operator, administrator and viewer."""
    travel = Travel()
    stage = SimulatedStage(travel)
    stage.line.clock = stage.line.port.clock = PacedClock(_FASTER)
    devices = Devices(_Camera(), {"stage": stage}, SimulatedLaser())
    camera = Camera.create((_COLUMNS, _ROWS), (120.0, 120.0), (79.5, 59.5))
    rig = Rig(camera, (LightPlane.create((0.0, -0.004, 0.003)),), Linear.create((0.0, 0.0009, -0.0004)))
    for i in range(projects):
        project = folder / "lab" / "projects" / f"kept{i}"
        (project / "frames").mkdir(parents=True)
        names = [f"frames/{j:04d}.png" for j in range(_PHOTOGRAPHS)]
        for j, name in enumerate(names):
            write_image(project / name, photograph(200 * j + i))
        listed = f"[scan]\nframes = {names}\nsteps = {[200 * j for j in range(_PHOTOGRAPHS)]}\n"
        (project / "scan.toml").write_text(listed.replace("'", '"'))
    raise_limit()
    lab = Lab(folder / "lab", lambda: devices, Habits({"stage": travel}), RigFile(rig))
    names = ("operator", "administrator", "viewer")
    for name in set(names).difference(account.name for account in lab.accounts.everybody()):
        lab.accounts.add(name, secrets.token_hex(), name == "administrator")
    tokens = [lab.accounts.make_token_for(name) for name in names]
    listening = bind("127.0.0.1", 0, tls=False, insecure=False)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    try:
        cert, key = tls or (None, None)
        Server(lab, listening, cert, key, lambda url: print(json.dumps([url, tokens]), flush=True)).serve_here()
    finally:
        lab.close()


if __name__ == "__main__":
    data, count, *files = sys.argv[1:]
    _serve(Path(data), int(count), (Path(files[0]), Path(files[1])) if files else None)
