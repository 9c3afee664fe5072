"""Points of projects and rigs of sessions, made in a process of their own.

What compiles and computes there takes no turn at the interpreter that stops the scanner, and no memory of the server's.
`python -m hardware.lab.reconstructor` reads orders line by line, and ends with the server that writes them.
"""

import contextlib
import json
import os
import signal
import subprocess
import sys
import tempfile
import threading
from pathlib import Path
from typing import Any, Final

from hardware.lab.processes import begin
from jaxscan.errors import InputError, JaxscanError

_NICER: Final = 10


class Reconstructor:
    """The process, begun when it is needed first, and again when it has ended."""

    def __init__(self) -> None:
        self._mutex = threading.Lock()
        self._child: subprocess.Popen[bytes] | None = None
        self._closed = False

    def make(self, rig: str, scan: Path, to: Path) -> None:
        """Write a scan's points.

        Args:
            rig: the text of its file.
            scan: the scan's folder.
            to: the PLY file.

        Raises:
            InputError: it has none, or the process ended.
        """
        self._order({"rig": rig, "scan": str(scan), "to": str(to)}, scan)

    def calibrate(self, session: Path, to: Path) -> list[str]:
        """Write the rig of a calibration session.

        Args:
            session: its folder.
            to: the JSON file.

        Returns:
            The verdict on it: how good it is, what limits it, what to photograph next, and warnings, a line each.

        Raises:
            InputError: it has none, or the process ended.
        """
        return self._order({"session": str(session), "to": str(to)}, session)

    def _order(self, order: dict[str, str], what: Path) -> list[str]:
        with self._mutex:
            if self._closed:
                raise InputError("the server ends: ask the next one")
            if self._child is None or self._child.poll() is not None:
                self._end()
                self._child = begin(__name__, stdin=subprocess.PIPE, stdout=subprocess.PIPE)
            child = self._child
            assert child.stdin is not None
            assert child.stdout is not None
            answer = b""
            with contextlib.suppress(OSError):
                child.stdin.write(json.dumps(order).encode() + b"\n")
                child.stdin.flush()
                answer = child.stdout.readline()
        if not answer:
            raise InputError(f"{what}: the process that works on it ended, perhaps for want of memory: try again")
        said = json.loads(answer)
        if said["wrong"]:
            raise InputError(said["wrong"])
        return said["lines"]

    def close(self) -> None:
        """End the process, whatever it does."""
        self._closed = True
        if self._child is not None:
            self._child.kill()
        with self._mutex:
            self._end()

    def _end(self) -> None:
        if self._child is not None:
            self._child.kill()
            self._child.communicate()
        self._child = None


def _done(order: dict[str, Any]) -> dict[str, Any]:
    """Carry out one order; what is to be said of it, or why it was not done."""
    try:
        return {"wrong": "", "lines": (_calibrate if "session" in order else _make)(order)}
    except JaxscanError as error:
        return {"wrong": str(error), "lines": []}
    except Exception as error:  # noqa: BLE001 (the next order may do)
        return {"wrong": f"unexpected error: {type(error).__name__}: {error}", "lines": []}


def _make(order: dict[str, Any]) -> list[str]:
    from jaxscan import read_rig, read_scan, reconstruct, write_points

    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "rig.json"
        rig.write_text(order["rig"])
        write_points(Path(order["to"]), reconstruct(read_rig(rig), read_scan(Path(order["scan"]))))
    return []


def _calibrate(order: dict[str, Any]) -> list[str]:
    from jaxscan.cli.calibrate import calibrate_session, judge_calibration

    judged = judge_calibration(calibrate_session([Path(order["session"])], Path(order["to"])))
    warned = [f"warning: {box.statement} {box.advice}".rstrip() for box in judged.warnings]
    return [
        judged.statement,
        f"what limits it: {judged.limits}",
        f"photograph next: {judged.next}",
        *warned,
    ]


def main() -> None:
    """Carry out orders until there are no more."""
    from jaxscan.cli.compiled import keep_compiled

    for one in (signal.SIGINT, getattr(signal, "SIGHUP", None)):
        if one is not None:
            signal.signal(one, signal.SIG_IGN)
    with contextlib.suppress(AttributeError, OSError):
        os.nice(_NICER)
    # Answers alone go back; whatever else is said goes where errors go.
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(2, 1)
    keep_compiled()
    for line in sys.stdin:
        answers.write(json.dumps(_done(json.loads(line))) + "\n")
        answers.flush()


if __name__ == "__main__":
    main()
