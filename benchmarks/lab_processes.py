"""What the benchmark of the lab runs in processes of their own: a server whose stage takes its time, and watchers."""

import asyncio
import contextlib
import json
import re
import secrets
import signal
import subprocess
import sys
import time
from collections.abc import AsyncIterator, Mapping
from pathlib import Path
from typing import Final

import httpx
import numpy as np

from hardware.clock import PacedClock
from hardware.frame import Frame
from hardware.lab.lab import Lab
from hardware.lab.server import Server, bind
from hardware.lab.worker import Habits
from hardware.scan import Devices
from hardware.simulated.laser import SimulatedLaser
from hardware.simulated.stage import SimulatedStage
from hardware.stages import Travel

OPERATOR, WATCHER = "operator", "watcher"
# A move takes a second on a stage of a real controller, the least that its driver watches a leg.
_FASTER: Final = 8
_END_S: Final = 30.0
_PHOTOGRAPHS, _SIZE = 40, (480, 640)


class _Camera:
    """Shows photographs with a stripe, one after the other."""

    def __init__(self) -> None:
        random, rows = np.random.default_rng(0), np.arange(_SIZE[0])[:, None]
        self._images = []
        for i in range(_PHOTOGRAPHS):
            image = random.integers(18, 26, (*_SIZE, 3), np.uint8)
            center = 120 + 6 * i + 10 * np.sin(np.arange(_SIZE[1]) / 80)
            image[..., 0] += (200 * np.exp(-((rows - center) ** 2) / 8)).astype(np.uint8)
            self._images.append(image)
        self._next = 0

    def open(self) -> None:
        """It is."""

    def configure(self, exposure_s: float, gain: float = 1.0) -> None:
        """Nothing to set."""

    def expose(self, positions: Mapping[str, int]) -> Frame:
        """The next one."""
        self._next = (self._next + 1) % _PHOTOGRAPHS
        return Frame(self._images[self._next], positions, time.time(), 0.01)

    def close(self) -> None:
        """Nothing to do."""


def _serve(folder: Path, watchers: int) -> None:
    """Serve until terminated; says where, and with which tokens, the operator's first."""
    travel = Travel()
    stage = SimulatedStage(travel)
    stage.line.clock = stage.line.port.clock = PacedClock(_FASTER)
    devices = Devices(_Camera(), {"stage": stage}, SimulatedLaser())
    lab = Lab(folder, lambda: devices, Habits({"stage": travel}))
    for name in (OPERATOR, WATCHER):
        lab.accounts.add(name, secrets.token_hex())
    tokens = [lab.accounts.make_token_for(name) for name in (OPERATOR, *[WATCHER] * watchers)]
    listening = bind("127.0.0.1", 0, tls=False, insecure=False)
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    try:
        Server(lab, listening, ready=lambda url: print(json.dumps([url, tokens]), flush=True)).serve_here()
    finally:
        lab.close()


class _Watchers:
    """Two streams each, read as they come, by as little code as will do: it runs on the same machine."""

    def __init__(self, url: str):
        self._url = httpx.URL(url)
        self.errors, self.second_operators, self.states, self.connected = 0, 0, 0, 0
        self.pictures: list[list[float]] = []

    async def events(self, token: str) -> None:
        """Every change of state, and who operates in it."""
        async for chunk in self._stream("/api/events", token):
            self.states += chunk.count(b"event: state")
            # A message may be cut in two by the line; whoever is named in one is the operator.
            self.second_operators += sum(
                name != OPERATOR.encode() for name in re.findall(rb'"operator":\{"name":"(\w+)', chunk)
            )

    async def watch(self, token: str) -> None:
        """Every picture."""
        counted = [0, 0.0]
        self.pictures.append(counted)
        begin_s = time.monotonic()
        async for chunk in self._stream("/api/pictures", token):
            counted[0] += chunk.count(b"--picture\r\nContent-Type") or chunk.count(b"Content-Type: image/jpeg")
            counted[1] = time.monotonic() - begin_s

    async def meddle(self, token: str) -> None:
        """Try to operate too, now and then."""
        async with httpx.AsyncClient(base_url=self._url, headers=bearer(token), timeout=30, trust_env=False) as client:
            while True:
                lock = await client.post("/api/lock", json={})
                order = await client.post("/api/jobs", json={"kind": "home"})
                self.second_operators += (lock.status_code != 409) + (order.status_code != 403)
                await asyncio.sleep(0.5)

    async def _stream(self, path: str, token: str) -> AsyncIterator[bytes]:
        try:
            reader, writer = await asyncio.open_connection(self._url.host, self._url.port)
            writer.write(f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {token}\r\n\r\n".encode())
            head = await reader.readuntil(b"\r\n\r\n")
            if not head.startswith(b"HTTP/1.1 200"):
                raise ConnectionError(head)
            self.connected += 1
            while chunk := await reader.read(1 << 16):
                yield chunk
            raise ConnectionError("the stream ended")
        except OSError:
            self.errors += 1
            raise


def end(child: "subprocess.Popen[str]") -> None:
    """End a process, and what it has begun: by force where it takes too long."""
    child.terminate()
    try:
        child.communicate(timeout=_END_S)
    except subprocess.TimeoutExpired:
        child.kill()
        child.communicate()


def bearer(token: str) -> dict[str, str]:
    return {"Authorization": f"Bearer {token}"}


async def _watch(url: str, count: int) -> None:
    tokens = json.loads(sys.stdin.readline())
    watchers = _Watchers(url)
    tasks = [asyncio.create_task(watchers.meddle(tokens[0]))]
    for i in range(count):
        token = tokens[i % len(tokens)]
        tasks += [asyncio.create_task(watchers.events(token)), asyncio.create_task(watchers.watch(token))]
        await asyncio.sleep(0.01)
    while watchers.connected < 2 * count and not watchers.errors:
        await asyncio.sleep(0.05)
    print("watching", flush=True)
    await asyncio.get_running_loop().run_in_executor(None, sys.stdin.readline)
    seen = {
        "errors": watchers.errors + sum(task.done() for task in tasks),
        "second_operators": watchers.second_operators,
        "states": watchers.states / count,
        "pictures": [counted for counted in watchers.pictures if counted[1]],
    }
    print(json.dumps(seen), flush=True)
    for task in tasks:
        task.cancel()
    await asyncio.gather(*tasks, return_exceptions=True)


if __name__ == "__main__":
    if sys.argv[1] == "serve":
        _serve(Path(sys.argv[2]), int(sys.argv[3]))
    else:
        with contextlib.suppress(KeyboardInterrupt):
            asyncio.run(_watch(sys.argv[2], int(sys.argv[3])))
