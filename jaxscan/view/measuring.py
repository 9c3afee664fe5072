"""The part of the viewer's panel that measures: a click on a face gives the feature, two give their distance."""

import threading
from collections.abc import Callable
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import JaxscanError
from jaxscan.files.part_file import FITTED, PART_FILE
from jaxscan.files.part_write import part_text
from jaxscan.measurement.clicked import Click, part_of_clicks
from jaxscan.measurement.measure import Measurement, measure
from jaxscan.measurement.rows import rows_of, value_in_words
from jaxscan.measurement.scanned import Scanned

_NOTHING, _BEFORE, _NONE = "nothing", "the one before", "none"
_COLOURS: Final = ((230, 60, 40), (30, 110, 220), (30, 160, 70), (170, 60, 200), (220, 160, 0), (0, 160, 170))
# Points of a feature, and its name, are drawn so large, in parts of the size of what is shown.
_POINT: Final = 0.004
# Of how many points.
_SHOWN: Final = 3000
# Clicks nearer to each other than this part of the radius are on one place: the second of an impatient hand.
_SAME: Final = 0.1


class Measuring:
    """What was clicked, measured, in words and drawn over the surface.

    Args:
        server: viser's.
        read: reads the surface, once, when the first face is clicked.
        middle: the place of the object frame that stands in the scene's origin, mm.
        size: of what is shown, mm.
        name: of the part.
    """

    def __init__(
        self, server: Any, read: Callable[[], Scanned], middle: Float[np.ndarray, "3"], size: float, name: str
    ) -> None:
        self._scene, self._read, self._middle, self._size, self._name = server.scene, read, middle, size, name
        self._scanned: Scanned | None = None
        self._clicks: tuple[Click, ...] = ()
        self._table = "Click a face."
        self._drawn: list[Any] = []
        self._mutex = threading.Lock()
        gui = server.gui
        with gui.add_folder("measure"):
            self._kind = gui.add_dropdown("a click measures", (*FITTED, _NOTHING), initial_value=FITTED[0])
            self._whole = gui.add_checkbox(
                "the whole face", initial_value=False, hint="as far as it goes on beyond the radius (range images)"
            )
            self._from = gui.add_dropdown(
                "distance from", (_BEFORE, _NONE), initial_value=_BEFORE, hint="distance and angle to which feature"
            )
            self._words = gui.add_markdown("Click a face; then another, for their distance.")
            self._undo = gui.add_button("undo the last", visible=False)
            self._save = gui.add_button(f"save {PART_FILE}", visible=False)
        self._undo.on_click(self._undone)
        self._save.on_click(self._saved)

    def clicked(self, place: Float[np.ndarray, "3"], radius: float) -> None:
        """A place on the surface was clicked; a second click on it is no second feature."""
        if self._kind.value == _NOTHING:
            return
        with self._mutex:
            x, y, z = map(float, place)
            measured_from = len(self._clicks) - 1 if self._clicks else None
            if self._from.value != _BEFORE:
                names = [each.name for each in part_of_clicks(self._clicks).features]
                measured_from = names.index(self._from.value) if self._from.value in names else None
            click = Click(self._kind.value, (x, y, z), radius, bool(self._whole.value), measured_from)
            if self._clicks and self._from.value == _BEFORE and _same_face(click, self._clicks[-1]):
                self._words.content = f"{self._table}\n\nThis place was clicked already."
            else:
                self._change((*self._clicks, click))

    def _undone(self, _: Any) -> None:
        with self._mutex:
            self._change(self._clicks[:-1])

    def _change(self, clicks: tuple[Click, ...]) -> None:
        """Measure these; a click that gives no feature is not kept, and the reason is shown. The mutex is held."""
        self._words.content = "measuring …"
        try:
            found = self._measured(clicks)
        except JaxscanError as error:
            self._words.content = f"Not measured: {error}"
            return
        problem = next((each for each in reversed(found.features) if each.problem), None)
        if problem is not None:
            self._words.content = f"{self._table}\n\nNot a {problem.feature.kind}: {problem.problem}"
            return
        self._clicks, self._table = clicks, _table(found)
        self._words.content = self._table
        self._undo.visible = self._save.visible = bool(clicks)
        names = tuple(each.feature.name for each in found.features)
        kept = self._from.value
        self._from.options = (_BEFORE, _NONE, *names)
        self._from.value = kept if kept in self._from.options else _BEFORE
        self._draw(found)

    def _measured(self, clicks: tuple[Click, ...]) -> Measurement:
        if self._scanned is None:
            self._scanned = self._read()
        return measure(self._scanned, part_of_clicks(clicks, self._name))

    def _draw(self, found: Measurement) -> None:
        for each in self._drawn:
            each.remove()
        self._drawn = []
        for number, each in enumerate(found.features):
            points = each.some_points(_SHOWN) - self._middle
            place, colour = f"/measured/{number}", _COLOURS[number % len(_COLOURS)]
            self._drawn.append(
                self._scene.add_point_cloud(
                    place, points.astype(np.float32), colour, point_size=_POINT * self._size, precision="float32"
                )
            )
            # It goes with its points.
            self._scene.add_label(f"{place}/name", each.feature.name, position=points.mean(axis=0))

    def _saved(self, event: Any) -> None:
        if event.client is not None:
            text = part_text(part_of_clicks(self._clicks, self._name))
            event.client.send_file_download(PART_FILE, text.encode(), save_immediately=True)


def _same_face(one: Click, other: Click) -> bool:
    apart = float(np.linalg.norm(np.subtract(one.place, other.place)))
    return (one.kind, one.radius, one.grow) == (other.kind, other.radius, other.grow) and apart < _SAME * one.radius


def _table(found: Measurement) -> str:
    """Features and dimensions as a table of Markdown, and what is to be said of all."""
    lines = ["| | |", "|---|---|"]
    lines += [f"| {each.feature.name} | {each.points} points, {each.left_out} left out |" for each in found.features]
    lines += [f"| {row['name']} | {value_in_words(row)} |" for row in rows_of(found)]
    shown = lines if found.features else ["Click a face."]
    return "\n".join([*shown, *(f"\n{note}" for note in found.every_note)])
