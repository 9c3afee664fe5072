"""A calibration session taken under guidance: what to do with the board next, and the stage's sequence by itself."""

from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Final, Protocol

import cv2
import numpy as np
from jaxtyping import Float

from hardware.frame import Frame
from hardware.safety import safely
from hardware.scan import Devices, ensure_homed
from jaxscan.errors import InputError
from jaxscan.files.session import SESSION_FILE, Session, StageImages, Views, write_session
from jaxscan.images import Board, StripeSettings, find_board, write_image

# The image is looked at in so many columns and rows of cells.
_CELLS: Final = (4, 3)
# A lean of the board's normal, its sine, that counts as tilted.
_TILTED: Final = 0.35
# A focal length for telling tilts apart before the camera is known, in image widths.
_GUESSED_FOCAL: Final = 1.2
_LEAST_STAGE: Final = 2
ON_STAGE: Final = "fix the board on the stage so that it stays in view over the whole travel, and step aside"


class Operator(Protocol):
    """Who holds the board."""

    def ready(self, wish: str) -> bool:
        """Ask for something; returns when it is done, with False to end."""
        ...

    def say(self, words: str) -> None:
        """Tell what became of it."""
        ...


class Coverage:
    """What the views so far show, and what is missing most."""

    def __init__(self, board: Board):
        self._board = board
        self._size = (0, 0)
        self._cells = np.zeros(_CELLS[::-1], int)
        self._normals: list[Float[np.ndarray, 3]] = []

    def add(self, corners: Float[np.ndarray, "points 2"], size: tuple[int, int]) -> None:
        """Take in the corners of one view (pixels, NaN where not seen) of an image of so many columns and rows."""
        self._size = size
        seen = np.isfinite(corners).all(axis=1)
        cell = np.floor((corners[seen] + 0.5) / size * _CELLS).astype(int).clip(0, np.array(_CELLS) - 1)
        np.add.at(self._cells, (cell[:, 1], cell[:, 0]), 1)
        focal = _GUESSED_FOCAL * size[0]
        K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
        found, rotation, _ = cv2.solvePnP(self._board.points()[seen], corners[seen], K, None)
        if found:
            self._normals.append(cv2.Rodrigues(rotation)[0][:, 2])

    @property
    def share(self) -> float:
        """Share of the image's cells that hold a corner."""
        return float((self._cells > 0).mean())

    def wish(self) -> str:
        """What to do with the board next."""
        if not self._normals:
            return "hold the board so that it fills the middle of the image, with the stripe across it"
        x, y = np.array(self._normals)[:, 0], np.array(self._normals)[:, 1]
        # The normal points away from the camera and leans towards the nearer edge.
        leans = {"right": x.max(), "left": -x.min(), "lower": y.max(), "upper": -y.min()}
        edge = min(leans, key=lambda name: leans[name])
        if leans[edge] < _TILTED:
            return f"now tilt the board by 30° to 45°, its {edge} edge nearer to the camera, the stripe across it"
        if self.share < 1:
            row, column = np.argwhere(self._cells == self._cells.min())[0]
            side = ("left", "middle", "middle", "right")[column]
            height = ("upper", "middle", "lower")[row]
            return f"now move the board to the {height} {side} of the image, tilted, the stripe across it"
        near = len(self._normals) % 2
        return f"now hold the board {'nearer' if near else 'further away'}, tilted otherwise, the stripe across it"


def guided_session(
    folder: Path,
    devices: Devices,
    board: Board,
    operator: Operator,
    *,
    views: int = 11,
    stage_steps: Sequence[int] = (),
    settle_s: float = 0.2,
    stripe: StripeSettings | None = None,
) -> Session:
    """Take a session, and write `session.toml` after every photograph.

    Where the laser can be switched, every pose is photographed without and with it.

    Args:
        folder: new or empty.
        devices: open.
        board: what is held.
        operator: who holds it.
        views: how many poses; the operator may end earlier.
        stage_steps: where to photograph the board on the stage; none for a rig without a stage.
        settle_s: how long to wait at each of those.
        stripe: how the laser's stripe is looked for.

    Raises:
        InputError: the folder holds something, or fewer than two stage photographs show the board.
        HardwareError: as `scan.take`.
    """
    if folder.is_dir() and any(folder.iterdir()):
        raise InputError(f"{folder}: is not empty: name a folder that is new or empty")
    for name in ("boards", "stripes", "stage"):
        (folder / name).mkdir(parents=True, exist_ok=True)
    camera, stage, laser = devices
    separate = laser.switchable
    stripe = stripe or StripeSettings()
    session = Session(
        folder / SESSION_FILE, board, Views((), {stripe.name: ()} if separate else None), lasers=(stripe,)
    )
    coverage = Coverage(board)

    def look(frame: Frame) -> Float[np.ndarray, "points 2"] | None:
        found = find_board(board, frame.image)
        return None if found is None else found.corners

    with safely(stage, laser):
        if not separate:
            laser.on()
        while len(session.views.boards) < views and operator.ready(coverage.wish()):
            number = len(session.views.boards)
            frame = camera.expose(0)
            corners = look(frame)
            if corners is None:
                operator.say("the board was not found: hold the whole of it in view, still, and in even light")
                continue
            path = folder / "boards" / f"{number:02d}.png"
            write_image(path, frame.image)
            stripes = session.views.stripes
            if stripes is not None:
                laser.on()
                write_image(folder / "stripes" / path.name, camera.expose(0).image)
                laser.off()
                stripes = {stripe.name: (*stripes[stripe.name], folder / "stripes" / path.name)}
            size = (frame.image.shape[1], frame.image.shape[0])
            session = replace(session, views=Views((*session.views.boards, path), stripes), image_size=size)
            write_session(session)
            coverage.add(corners, size)
            operator.say(f"view {number + 1}: {100 * coverage.share:.0f} % of the image has had a corner")
        if not stage_steps or not operator.ready(ON_STAGE):
            return session
        ensure_homed(stage)
        for number, step in enumerate(stage_steps):
            stage.move_to(step)
            stage.settle(settle_s)
            frame = camera.expose(stage.position())
            if look(frame) is None:
                operator.say(f"step {step}: the board was not found, this place is left out")
                continue
            path = folder / "stage" / f"{number:02d}.png"
            write_image(path, frame.image)
            before = session.stage or StageImages((), ())
            session = replace(session, stage=StageImages((*before.images, path), (*before.steps, step)))
            if len(before.images) + 1 >= _LEAST_STAGE:
                write_session(session)
            operator.say(f"step {step}: {number + 1} of {len(stage_steps)}")
    if session.stage is None or len(session.stage.images) < _LEAST_STAGE:
        raise InputError(f"{folder}: fewer than {_LEAST_STAGE} stage photographs show the board: fix it in view")
    return session
