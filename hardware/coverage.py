"""What the views of a calibration session have shown of image and tilts, and what is missing most."""

from typing import Final

import cv2
import numpy as np
from jaxtyping import Bool, Float, UInt8

from jaxscan.images import Board

ON_STAGE: Final = "fix the board on the stage so that it stays in view over the whole travel, and step aside"
ON_TURNTABLE: Final = (
    "lean the board on the turntable, about its middle and tilted by some 40°, fix it so that it stays in view as it "
    "turns, and step aside"
)
# The image is divided into this number of columns and rows of cells.
_CELLS: Final = (4, 3)
# A lean of the board's normal, its sine, that counts as tilted.
_TILTED: Final = 0.35
# A focal length for telling tilts apart before the camera is known, in image widths.
_GUESSED_FOCAL: Final = 1.2
_COVERED_COLOUR, _GRID_COLOUR = (40, 200, 90), (200, 200, 200)
_TINT: Final = 0.25


class ViewsSoFar:
    """What the views so far have shown."""

    def __init__(self, board: Board):
        self._board = board
        self._cells = np.zeros(_CELLS[::-1], int)
        self._normals: list[Float[np.ndarray, 3]] = []

    def add(self, corners: Float[np.ndarray, "points 2"], size: tuple[int, int]) -> None:
        """Add the corners of one view (pixels, NaN where not seen) of an image of `size` (columns, rows)."""
        seen = np.isfinite(corners).all(axis=1)
        cell = np.floor((corners[seen] + 0.5) / size * _CELLS).astype(int).clip(0, np.array(_CELLS) - 1)
        np.add.at(self._cells, (cell[:, 1], cell[:, 0]), 1)
        focal = _GUESSED_FOCAL * size[0]
        K = np.array([[focal, 0, (size[0] - 1) / 2], [0, focal, (size[1] - 1) / 2], [0, 0, 1]])
        found, rotation, _ = cv2.solvePnP(self._board.points()[seen], corners[seen], K, None)
        if found:
            self._normals.append(cv2.Rodrigues(rotation)[0][:, 2])

    @property
    def covered(self) -> Bool[np.ndarray, "cell_rows cell_columns"]:
        """Which cells of the image have held a corner."""
        return self._cells > 0

    @property
    def share(self) -> float:
        """Share of the image's cells that have."""
        return float(self.covered.mean())

    @property
    def tilted(self) -> dict[str, bool]:
        """Whether the board has been tilted with each of its edges towards the camera."""
        return {edge: lean >= _TILTED for edge, lean in self._leans().items()}

    def wish(self) -> str:
        """What to do with the board next."""
        if not self._normals:
            return "hold the board so that it fills the middle of the image, with the stripe across it"
        leans = self._leans()
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

    def _leans(self) -> dict[str, float]:
        """The greatest lean towards each edge: the normal points away from the camera, to the nearer edge."""
        x, y = np.array([[0.0, 0.0], *(normal[:2] for normal in self._normals)]).T
        return {"right": x.max(), "left": -x.min(), "lower": y.max(), "upper": -y.min()}


def draw_coverage(
    picture: UInt8[np.ndarray, "rows columns 3"], covered: Bool[np.ndarray, "cell_rows cell_columns"]
) -> UInt8[np.ndarray, "rows columns 3"]:
    """A picture with its cells, those that are covered in green."""
    shown = picture.copy()
    rows, columns = (
        np.linspace(0, length, count + 1).round().astype(int)
        for length, count in zip(picture.shape, covered.shape, strict=False)
    )
    for row, column in np.argwhere(covered):
        cell = shown[rows[row] : rows[row + 1], columns[column] : columns[column + 1]]
        cell[:] = (1 - _TINT) * cell + _TINT * np.array(_COVERED_COLOUR)
    for v in rows[1:-1]:
        cv2.line(shown, (0, int(v)), (picture.shape[1], int(v)), _GRID_COLOUR)
    for u in columns[1:-1]:
        cv2.line(shown, (int(u), 0), (int(u), picture.shape[0]), _GRID_COLOUR)
    return shown
