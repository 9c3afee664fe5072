"""Points of projects, what is measured of them, and rigs of sessions, made in a process of their own.

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
from functools import lru_cache
from pathlib import Path
from typing import TYPE_CHECKING, Any, Final

from hardware.lab.processes import begin
from jaxscan.atomic import replacing
from jaxscan.errors import InputError, JaxscanError

if TYPE_CHECKING:
    from hardware.lab.measuring import Clicks, Found
    from jaxscan import RigFile
    from jaxscan.measurement.scanned import Scanned

_NICER: Final = 10
# Most points of a scan, and of a face, that pages draw; digits of their coordinates, mm.
_DRAWN, _OF_FACE, _DIGITS = 60_000, 400, 3
_OF_DIMENSION: Final = ("name", "value", "uncertainty", "unit")


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
            to: a PLY file; or a range image (.npz), beside which some of the points are put for pages to draw
                (.points): x, y, z, float32, little endian, mm.

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

    def measure(self, rig: str, image: Path, name: str, clicks: "Clicks") -> "Found":
        """Measure faces that were clicked.

        Args:
            rig: the text of its file.
            image: the range image.
            name: of the part.
            clicks: the faces.

        Raises:
            InputError: they are none, or the process ended.
        """
        from hardware.lab.measuring import Found

        order = {"rig": rig, "measure": str(image), "name": name, "clicks": clicks.model_dump_json()}
        return Found.model_validate_json(self._order(order, image)[0])

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
        work = _calibrate if "session" in order else _measure if "measure" in order else _make
        return {"wrong": "", "lines": work(order)}
    except JaxscanError as error:
        return {"wrong": str(error), "lines": []}
    except Exception as error:  # noqa: BLE001 (the next order may do)
        return {"wrong": f"unexpected error: {type(error).__name__}: {error}", "lines": []}


def _make(order: dict[str, Any]) -> list[str]:
    import numpy as np

    from jaxscan import read_scan, reconstruct, write_points

    to = Path(order["to"])
    image = reconstruct(_rig(order), read_scan(Path(order["scan"])))
    if to.suffix == ".npz":
        points = image.points[image.valid]
        some = points[np.unique(np.linspace(0, len(points) - 1, min(len(points), _DRAWN)).astype(int))]
        with replacing(to.with_suffix(".points"), "wb") as file:
            file.write(some.astype("<f4").tobytes())
    write_points(to, image)
    return []


def _rig(order: dict[str, Any]) -> "RigFile":
    from jaxscan import read_rig

    with tempfile.TemporaryDirectory() as folder:
        rig = Path(folder) / "rig.json"
        rig.write_text(order["rig"])
        return read_rig(rig)


def _measure(order: dict[str, Any]) -> list[str]:
    from hardware.lab.measuring import Clicks, Face, Found, FoundDimension
    from jaxscan.files.part_write import part_text
    from jaxscan.measurement.clicked import Click, part_of_clicks
    from jaxscan.measurement.measure import measure
    from jaxscan.measurement.rows import rows_of, value_in_words

    faces = Clicks.model_validate_json(order["clicks"]).faces
    clicks = [
        Click(each.kind, (each.place[0], each.place[1], each.place[2]), each.radius, each.grow, each.measured_from)
        for each in faces
    ]
    part = part_of_clicks(clicks, order["name"])
    found = measure(_scanned(order["measure"], order["rig"]), part)
    answer = Found(
        faces=[
            Face(
                name=each.feature.name,
                points=each.some_points(_OF_FACE).round(_DIGITS).tolist(),
                count=each.points,
                left_out=each.left_out,
                problem=each.problem,
            )
            for each in found.features
        ],
        dimensions=[
            FoundDimension(words=value_in_words(row), **{key: row[key] for key in _OF_DIMENSION})
            for row in rows_of(found)
        ],
        notes=list(found.every_note),
        part=part_text(part),
    )
    return [answer.model_dump_json()]


@lru_cache(1)
def _scanned(image: str, rig: str) -> "Scanned":
    """The last one stays: a page asks again with each click."""
    from jaxscan import read_range_image, scanned_image

    return scanned_image(read_range_image(image), _rig({"rig": rig}))


_NO_AXIS: Final = (
    "No axis was calibrated: this rig turns no scan into points. Take a session with photographs on the stage."
)


def _calibrate(order: dict[str, Any]) -> list[str]:
    from jaxscan.cli.calibrate import calibrate_session, judge_calibration

    to = Path(order["to"])
    calibration = calibrate_session([Path(order["session"])], to)
    judged = judge_calibration(calibration, to)
    warned = [f"warning: {box.statement} {box.advice}".rstrip() for box in judged.warnings]
    if not calibration.rig.axes():
        warned.insert(0, f"warning: {_NO_AXIS}")
    return [
        judged.statement,
        f"what limits it: {judged.limits}",
        f"photograph next: {judged.next}",
        *warned,
    ]


def main() -> None:
    """Carry out orders until there are no more."""
    from jaxscan.cli.compiled import keep_compiled
    from jaxscan.cli.process import own

    own()
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
