"""What is shown of photographs: a JPEG, the stripe's profile, and with a rig the points so far.

Two threads of their own, so that neither a large photograph nor JAX's compiler holds up the scan.
"""

import json
import logging
import threading
from collections import deque
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Final

import cv2
import numpy as np
from jaxtyping import Float, UInt

from hardware.frame import Frame, in_words
from hardware.lab.hub import Hub
from hardware.lab.long_lived import set_aside
from hardware.places import Place
from hardware.scan_plan import ScanFolder
from jaxscan.errors import JaxscanError
from jaxscan.images import StripeSettings, read_image

if TYPE_CHECKING:
    from hardware.guide import Sight
    from jaxscan import RigFile
    from jaxscan.reconstruction import Kernel

_LOG: Final = logging.getLogger(__name__)
_WIDEST, _QUALITY = 1280, 80
# Photographs that wait to be measured in memory; of others the file is read when their turn comes.
_IN_MEMORY: Final = 4
# Most points of a profile (more are thinned) and of the cloud (which ends there).
_PROFILE_POINTS, _CLOUD_POINTS = 400, 400_000
# Live it counts that a profile is there at once: the quickest detector.
_DETECTOR: Final = "derivative"
# How long the end waits for what is being done: a first profile compiles, for minutes on a busy machine.
_ENDED_S: Final = 5.0


class _Thread:
    """Does one thing after the other, and goes on when one fails."""

    def __init__(self, name: str, room: int | None):
        self._waiting: deque[Callable[[], object]] = deque(maxlen=room)
        self._come = threading.Condition()
        self._closed = False
        self._thread = threading.Thread(target=self._work, name=name, daemon=True)
        self._thread.start()

    def __len__(self) -> int:
        return len(self._waiting)

    def do(self, work: Callable[[], object]) -> None:
        with self._come:
            self._waiting.append(work)
            self._come.notify()

    @property
    def alive(self) -> bool:
        """Whether it has not ended."""
        return self._thread.is_alive()

    def close(self) -> None:
        """End, after what is being done if that ends soon."""
        with self._come:
            self._closed = True
            self._come.notify()
        self._thread.join(_ENDED_S)

    def _work(self) -> None:
        while True:
            with self._come:
                self._come.wait_for(lambda: self._waiting or self._closed)
                if self._closed:
                    return
                work = self._waiting.popleft()
            try:
                work()
            except JaxscanError as error:
                _LOG.warning("a photograph is not shown: %s", error)
            except Exception:  # noqa: BLE001 (said in the log; the next photograph may do)
                _LOG.exception("a photograph is not shown")


class Gallery:
    """Shows photographs to a hub.

    Args:
        hub: where to: `picture` is a JPEG, `profile` JSON.
        stripe: how the laser's stripe is looked for.
        rig: of the scanner; without one profiles are in pixels, and there is no cloud.
    """

    def __init__(self, hub: Hub, stripe: StripeSettings, rig: "RigFile | None" = None):
        self._hub, self._stripe, self._rig = hub, stripe, rig
        # Of pictures only the latest is worth the work.
        self._pictures, self._profiles = _Thread("pictures", 1), _Thread("profiles", None)
        self._kernel: Kernel | None = None
        self._compiled = False
        self._mutex = threading.Lock()
        self._project = ""
        self._cloud: list[Float[np.ndarray, "points 3"]] = []

    def use(self, rig: "RigFile | None") -> None:
        """Make points with another rig from the next photograph on, or none; those of the old one are dropped."""
        self._profiles.do(lambda: self._use(rig))

    def _use(self, rig: "RigFile | None") -> None:
        self._rig, self._kernel = rig, None
        self._clear(self._project)

    def begin(self, project: str, scan: ScanFolder) -> None:
        """A job adds photographs to a project: its cloud begins with those that it has."""
        self._profiles.do(lambda: self._clear(project))
        for number, (path, place) in enumerate(zip(scan.done.frames, scan.taken, strict=True)):
            if self._rig is not None:
                self._profiles.do(
                    lambda path=path, place=place, number=number: self._measure(None, path, place, number)
                )

    def show(self, frame: Frame, path: Path | None = None) -> None:
        """Show a photograph, and once it is part of a project its profile."""
        self._pictures.do(lambda: self._hub.publish("picture", jpeg(frame.image)))
        if path is not None:
            image = frame.image if len(self._profiles) < _IN_MEMORY else None
            self._profiles.do(lambda: self._measure(image, path, dict(frame.positions), int(path.stem)))

    def see(self, sight: "Sight") -> None:
        """Show a photograph of the board, with what was found in it."""
        self._pictures.do(lambda: self._hub.publish("picture", jpeg(sight.picture())))

    def cloud(self) -> bytes:
        """The points so far, float32 x, y, z in mm, object frame, little endian."""
        with self._mutex:
            parts = list(self._cloud)
        return b"".join(np.ascontiguousarray(part, "<f4").tobytes() for part in parts)

    @property
    def alive(self) -> bool:
        """Whether it has not ended: once it is closed, that it is still at something that takes long."""
        return self._pictures.alive or self._profiles.alive

    def close(self) -> None:
        """End, and wait a few seconds for what is being done."""
        self._pictures.close()
        self._profiles.close()

    def _clear(self, project: str) -> None:
        with self._mutex:
            self._project, self._cloud = project, []

    def _measure(
        self, image: UInt[np.ndarray, "rows columns *rgb"] | None, path: Path, place: Place, number: int
    ) -> None:
        from jaxscan.cli.compiled import keep_compiled
        from jaxscan.images import detect_stripe

        keep_compiled()
        image = read_image(path) if image is None else image
        stripe = detect_stripe(image, self._stripe, detector=_DETECTOR)
        position, lines = stripe.position[0], np.flatnonzero(stripe.valid[0])
        lines = lines[:: max(1, -(-len(lines) // _PROFILE_POINTS))]
        found = {
            "project": self._project,
            "number": number,
            "positions": place,
            "place": in_words(place),
            "columns": self._stripe.columns,
            "line": lines.tolist(),
            "position": np.round(position[lines].astype(float), 2).tolist(),
        }
        if self._rig is not None and (problem := self._unfit((image.shape[1], image.shape[0]), place)):
            found["problem"] = problem
        elif self._rig is not None:
            points = self._points(lines, position[lines], place)
            with self._mutex:
                if sum(map(len, self._cloud)) < _CLOUD_POINTS:
                    self._cloud.append(points)
                found["cloud_points"] = sum(map(len, self._cloud))
            found["points"] = np.round(points.astype(float), 2).tolist()
        self._hub.publish("profile", json.dumps(found, separators=(",", ":")).encode())

    def _unfit(self, size: tuple[int, int], place: Place) -> str:
        """Why the rig makes no points of a photograph of this size; "" where it does."""
        from jaxscan.reconstruction.frames import wrong_size

        assert self._rig is not None
        rig = self._rig.rig
        if size != rig.camera.image_size:
            return wrong_size("no points", size, rig.camera.image_size)
        lacking = [name for name, step in place.items() if step and name not in rig.axes()]
        return f"no points: the rig has no axis {' or '.join(lacking)}: calibrate one that has" if lacking else ""

    def _points(
        self, lines: np.ndarray, position: Float[np.ndarray, "points"], place: Place
    ) -> Float[np.ndarray, "points 3"]:
        """Stripe pixels to points of the object frame, mm."""
        from jaxscan.reconstruction import Kernel
        from jaxscan.reconstruction.triangulate import FramePoses, triangulate

        assert self._rig is not None
        rig = self._rig.rig
        if self._kernel is None:
            self._kernel = Kernel.create(rig, self._stripe.name)

        # Always as many, so that nothing is compiled twice.
        along, across = (np.full((1, _PROFILE_POINTS), np.nan, np.float32) for _ in range(2))
        along[0, : len(lines)], across[0, : len(lines)] = lines, position
        u, v = (along, across) if self._stripe.columns else (across, along)
        frames = FramePoses.create(rig.motion, {name: np.array([step]) for name, step in place.items()}, 1)
        points = np.asarray(triangulate(self._kernel, frames, u, v))[0, : len(lines)]
        if not self._compiled:
            # What JAX keeps of it is more than all the rest of the server.
            self._compiled = True
            set_aside()
        points = points[np.isfinite(points).all(axis=1)]
        return points


def jpeg(image: UInt[np.ndarray, "rows columns *rgb"]) -> bytes:
    """A photograph as a JPEG no wider than a page shows it."""
    if image.dtype == np.uint16:
        image = (image >> 8).astype(np.uint8)
    shrink = _WIDEST / image.shape[1]
    if shrink < 1:
        image = cv2.resize(image, None, fx=shrink, fy=shrink, interpolation=cv2.INTER_AREA)
    if image.ndim == 3:
        image = cv2.cvtColor(image, cv2.COLOR_RGB2BGR)
    return cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, _QUALITY])[1].tobytes()
