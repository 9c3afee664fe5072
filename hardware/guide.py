"""A calibration session taken under guidance: what to do with the board next, and the axes' sequences by itself."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Final, Protocol

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from hardware.coverage import ON_STAGE, ON_TURNTABLE, ViewsSoFar, draw_coverage
from hardware.errors import PositionUncertainError
from hardware.frame import Frame
from hardware.places import STAGE, TURNTABLE
from hardware.safety import safely
from hardware.scan import Devices, ensure_homed, lost_steps, verifiable
from jaxscan.errors import InputError
from jaxscan.files.session import SESSION_FILE, Session, Views, write_session
from jaxscan.files.session_axes import StageImages, TurntableImages
from jaxscan.images import Board, StripeSettings, draw_board, find_board, write_image

_LEAST_VIEWS = 3
# Photographs of the board on an axis.
_LEAST: Final = {STAGE: 2, TURNTABLE: 3}
_WISHES: Final = {STAGE: ON_STAGE, TURNTABLE: ON_TURNTABLE}
# Live, the board is looked for at this length of the longer side.
_LIVE_SIDE: Final = 640


@dataclass(frozen=True)
class Sight:
    """A photograph, what was found in it, and the session that it came to.

    Attributes:
        frame: the photograph.
        corners: of the board, pixels; None where it was not found.
        session: what has been taken until then.
        covered: the cells of the image that have held a corner.
        tilted: the edges of the board that have been towards the camera.
    """

    frame: Frame
    corners: Float[np.ndarray, "points 2"] | None
    session: Session
    covered: Bool[np.ndarray, "cell_rows cell_columns"]
    tilted: dict[str, bool]

    def picture(self) -> UInt8[np.ndarray, "rows columns 3"]:
        """The photograph with the board's corners and the cells drawn over it."""
        board = self.session.board
        corners = np.full((board.counts[0] * board.counts[1], 2), np.nan) if self.corners is None else self.corners
        return draw_coverage(draw_board(self.frame.image, corners, board.counts), self.covered)


class Operator(Protocol):
    """Who holds the board."""

    def ready(self, wish: str, look: Callable[[], object]) -> bool:
        """Ask for something; returns when it is done, with False to end.

        Until then it may `look`, as often as it likes: a photograph is taken, and comes to `show`.
        """
        ...

    def show(self, sight: Sight) -> None:
        """Show a photograph."""
        ...

    def say(self, words: str) -> None:
        """Tell what became of it."""
        ...


def check_session(views: int, stage_steps: Sequence[int], turntable_steps: Sequence[int] = ()) -> None:
    """See that so much can be a session.

    Raises:
        InputError: too few poses, or too few places of the stage or the turntable, or one twice.
    """
    if views < _LEAST_VIEWS:
        raise InputError(f"{views} poses of the board: a calibration needs {_LEAST_VIEWS} or more, better 11")
    for name, steps in ((STAGE, stage_steps), (TURNTABLE, turntable_steps)):
        if steps and len(set(steps)) < max(_LEAST[name], len(steps)):
            raise InputError(
                f"{len(steps)} {name} photographs: give {_LEAST[name]} or more, at places of their own, or none"
            )


def guided_session(
    folder: Path,
    devices: Devices,
    board: Board,
    operator: Operator,
    *,
    views: int = 11,
    stage_steps: Sequence[int] = (),
    turntable_steps: Sequence[int] = (),
    turntable_at: int = 0,
    settle_s: float = 0.2,
    stripe: StripeSettings | None = None,
) -> Session:
    """Take a session, and write `session.toml` after every photograph.

    Where the laser can be switched, every pose is photographed without and with it; while the board is brought into
    its pose the laser is on, so that the stripe can be seen on it.

    Args:
        folder: new or empty.
        devices: open.
        board: what is held.
        operator: who holds it.
        views: how many poses; the operator may end earlier.
        stage_steps: where to photograph the board on the stage; none for a rig without a stage.
        turntable_steps: where to photograph it on the turntable; none for a rig without one.
        turntable_at: where the stage stands meanwhile, if there is one.
        settle_s: how long to wait at each of those.
        stripe: how the laser's stripe is looked for.

    Raises:
        InputError: the folder holds something, what was asked for is no session, the operator ended it before the
            third pose, the scanner lacks an axis, or fewer than two photographs on the stage, or three on the
            turntable, show the board.
        PositionUncertainError: an axis with a switch lost steps; its photographs are left out of `session.toml`.
        HardwareError: as `scan.take`.
    """
    check_session(views, stage_steps, turntable_steps)
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder}: is not empty: name a folder that is new or empty")
    sequences = {STAGE: stage_steps, TURNTABLE: turntable_steps}
    for name, steps in sequences.items():
        if steps and name not in devices.axes:
            raise InputError(f"{len(steps)} {name} photographs: this scanner has no {name}: leave them out (0)")
    stripe = stripe or StripeSettings()
    guide = _Guide(folder, devices, board, operator, stripe)
    with safely(devices.axes, devices.laser):
        guide.hold_board(views)
        for name, steps in sequences.items():
            if not steps or not guide.ask(_WISHES[name]):
                continue
            if guide.along(name, steps, settle_s, turntable_at) < _LEAST[name]:
                raise InputError(
                    f"{folder}: fewer than {_LEAST[name]} {name} photographs show the board: fix it in view"
                )
    return guide.session


class _Guide:
    """A session under way."""

    def __init__(self, folder: Path, devices: Devices, board: Board, operator: Operator, stripe: StripeSettings):
        self._folder, self._board, self._operator, self._stripe = folder, board, operator, stripe
        self._camera, self._axes, self._laser = devices
        self._separate = self._laser.switchable
        self._views = ViewsSoFar(board)
        stripes = {stripe.name: ()} if self._separate else None
        self.session = Session(folder / SESSION_FILE, board, Views((), stripes), lasers=(stripe,))

    def ask(self, wish: str) -> bool:
        """Ask the operator for something, who sees the stripe on the board meanwhile."""
        self._laser.on()
        try:
            return self._operator.ready(wish, self._look)
        finally:
            if self._separate:
                self._laser.off()

    def hold_board(self, views: int) -> None:
        """Photograph `views` poses, or as many as the operator likes."""
        while len(self.session.views.boards) < views:
            if not self.ask(self._views.wish()):
                if (taken := len(self.session.views.boards)) < _LEAST_VIEWS:
                    raise InputError(f"{self._folder}: ended after {taken} poses, and {_LEAST_VIEWS} are the least")
                return
            frame = self._camera.expose({})
            corners = self._corners(frame)
            if corners is None:
                self._show(frame, None)
                self._operator.say("the board was not found: hold the whole of it in view, still, and in even light")
                continue
            before, name = self.session.views, f"{len(self.session.views.boards):02d}.png"
            path = self._write("boards", name, frame)
            stripes = before.stripes
            if stripes is not None:
                self._laser.on()
                beside = self._write("stripes", name, self._camera.expose({}))
                self._laser.off()
                stripes = {self._stripe.name: (*stripes[self._stripe.name], beside)}
            size = (frame.image.shape[1], frame.image.shape[0])
            self.session = replace(self.session, views=Views((*before.boards, path), stripes), image_size=size)
            write_session(self.session)
            self._views.add(corners, size)
            self._show(frame, corners)
            number, share = len(self.session.views.boards), self._views.share
            self._operator.say(f"view {number}: {100 * share:.0f} % of the image has had a corner")

    def along(self, name: str, steps: Sequence[int], settle_s: float, stage_step: int) -> int:
        """Photograph the board along an axis; places where it is not found are left out.

        Args:
            name: stage or turntable.
            steps: its places.
            settle_s: how long to wait at each.
            stage_step: where the stage stands while the turntable turns.

        Returns:
            How many show the board.
        """
        axis = self._axes[name]
        ensure_homed({name: axis})
        rest = {}
        if name == TURNTABLE and STAGE in self._axes:
            ensure_homed({STAGE: self._axes[STAGE]})
            self._axes[STAGE].move_to(stage_step)
            rest = {STAGE: stage_step}
        paths: list[Path] = []
        places: list[int] = []
        for number, step in enumerate(steps):
            axis.move_to(step)
            axis.settle(settle_s)
            place = axis.position()
            frame = self._camera.expose({name: place, **rest})
            corners = self._corners(frame)
            if corners is None:
                self._show(frame, None)
                self._operator.say(f"step {step}: the board was not found, this place is left out")
                continue
            paths.append(self._write(name, f"{number:02d}.png", frame))
            places.append(place)
            if name == STAGE:
                self.session = replace(self.session, stage=StageImages(tuple(paths), tuple(places)))
            else:
                table = TurntableImages(tuple(paths), tuple(places), rest.get(STAGE, 0))
                self.session = replace(self.session, turntable=table)
            if len(paths) >= _LEAST[name]:
                write_session(self.session)
            self._show(frame, corners)
            self._operator.say(f"step {step}: {number + 1} of {len(steps)}")
        self._verify(name)
        return len(paths)

    def _verify(self, name: str) -> None:
        """See that the axis lost no steps along its photographs; with any, the session goes on without them."""
        lost, spoilt = lost_steps(verifiable(self._axes, {name, STAGE}))
        if spoilt:
            self._operator.say(f"the {name} photographs are not verified: {spoilt}")
        if lost:
            self.session = replace(self.session, **{name: None})
            write_session(self.session)
            words = " and ".join(f"the {axis} by {abs(steps)} steps" for axis, steps in lost.items())
            raise PositionUncertainError(
                f"steps were lost, {words}: {self.session.path} leaves the {name} photographs out; set a lower "
                "rate_steps_s or ramp_steps_s2, look that nothing is in the way, and take the session again"
            )

    def _write(self, kind: str, name: str, frame: Frame) -> Path:
        path = self._folder / kind / name
        path.parent.mkdir(parents=True, exist_ok=True)
        write_image(path, frame.image)
        return path

    def _look(self) -> None:
        frame = self._camera.expose({})
        longer = max(frame.image.shape)
        scale = min(_LIVE_SIDE / longer, 1.0)
        small = cv2.resize(frame.image, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        found = find_board(self._board, small)
        # Sizes change about the image's edge, which is at -0.5.
        self._show(frame, None if found is None else (found.corners + 0.5) / scale - 0.5)

    def _corners(self, frame: Frame) -> Float[np.ndarray, "points 2"] | None:
        found = find_board(self._board, frame.image)
        return None if found is None else found.corners

    def _show(self, frame: Frame, corners: Float[np.ndarray, "points 2"] | None) -> None:
        views = self._views
        self._operator.show(Sight(frame, corners, self.session, views.covered, views.tilted))
