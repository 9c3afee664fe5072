"""Cases are read in a process of their own, each with a limit on time and on memory."""

import json
import os
import select
import subprocess
import sys
import tempfile
import time
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from tests.fuzz.worker import GIB

# Of the processor: others may use it too.
LONGEST_S = 5.0
# By the clock an answer may take this many times as long.
_SLOWEST = 4
# Beyond the file itself. What a header allows is not granted on top: no seed's header needs it.
MOST_BYTES = GIB
_START_S = 120.0


@dataclass(frozen=True)
class Verdict:
    """How a case ended: read, refused, foreign, hang or hungry; and in words."""

    outcome: str
    said: str
    took_s: float = 0.0
    grew: int = 0

    @property
    def bad(self) -> bool:
        """Whether it is a fault of the reader."""
        return self.outcome not in ("read", "refused")


class Bench:
    """Readers of a module that has `READERS`, in a process that is started again whenever a case has ended it."""

    def __init__(self, module: str = "tests.fuzz.targets", longest_s: float = LONGEST_S):
        self._module, self._longest_s = module, longest_s
        self._process: subprocess.Popen[str] | None = None
        self._said = tempfile.TemporaryFile("w+")  # noqa: SIM115 (closed when the block ends)

    def __enter__(self) -> "Bench":
        return self

    def __exit__(self, *_: object) -> None:
        self._end()
        self._said.close()

    def judge(self, reader: str, path: Path) -> Verdict:
        """Read one file."""
        answer = self._ask({"reader": reader, "path": str(path)})
        if answer is None:
            return self._ended()
        verdict = Verdict(**answer)
        if verdict.outcome != "foreign" and verdict.grew > MOST_BYTES + path.stat().st_size:
            return Verdict("hungry", f"{verdict.grew / GIB:.2f} GiB: {verdict.said}", verdict.took_s, verdict.grew)
        if verdict.outcome != "foreign" and verdict.took_s > self._longest_s:
            return Verdict("hang", f"{verdict.took_s:.1f} s: {verdict.said}", verdict.took_s, verdict.grew)
        return verdict

    def _ended(self) -> Verdict:
        """What it means that there was no answer."""
        assert self._process is not None
        if self._process.poll() is None:
            self._end()
            return Verdict("hang", f"no answer in {_SLOWEST * self._longest_s:g} s")
        status = self._process.returncode
        self._said.seek(0)
        said = self._said.read()[-300:]
        self._end()
        return Verdict("foreign", f"the process ended with status {status}: {said}")

    def _ask(self, request: dict[str, str]) -> dict[str, Any] | None:
        if self._process is None:
            self._process = self._started()
        process = self._process
        assert process.stdin is not None
        process.stdin.write(json.dumps(request) + "\n")
        process.stdin.flush()
        line = _line(process, _SLOWEST * self._longest_s)
        return json.loads(line) if line else None

    def _started(self) -> "subprocess.Popen[str]":
        root = Path(__file__).parents[2]
        self._said.seek(0)
        self._said.truncate()
        process = subprocess.Popen(
            [sys.executable, "-X", "faulthandler", "-m", "tests.fuzz.worker", self._module],
            cwd=root,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=self._said,
            text=True,
            env=os.environ | {"OPENCV_FFMPEG_LOGLEVEL": "-8"},
        )
        if not _line(process, _START_S):
            self._said.seek(0)
            raise RuntimeError(f"the worker did not start: {self._said.read()[-2000:]}")
        return process

    def _end(self) -> None:
        if self._process is not None:
            self._process.kill()
            self._process.communicate()
            self._process = None


def _line(process: "subprocess.Popen[str]", seconds: float) -> str:
    """The next line of a process; "" where it ends first, or takes longer."""
    assert process.stdout is not None
    end, text = time.monotonic() + seconds, b""
    number = process.stdout.fileno()
    while not text.endswith(b"\n"):
        ready, _, _ = select.select([number], [], [], max(0.0, end - time.monotonic()))
        piece = os.read(number, 1 << 16) if ready else b""
        if not piece:
            if ready:
                process.wait(10)
            return ""
        text += piece
    return text.decode()
