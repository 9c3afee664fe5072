"""Windows about places in a batch are measured, and measured again where they show that another look is needed.

A line is looked at in a short window first. Where that was too narrow, where the stripe is burnt out, or its speckle
ragged, it is measured again by itself, in another window or with another model of its profile.
"""

from collections.abc import Iterator
from dataclasses import dataclass, replace
from math import prod
from typing import Any, Final

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.detectors import Detector
from jaxscan.images.stripes.batch import NARROW, SHORT, WIDE, Batch
from jaxscan.images.stripes.detectors import OF_SOMETHING_MORE, Model, measure
from jaxscan.images.stripes.light import Light
from jaxscan.images.stripes.likelihood import FEW_STEPS_CENSORED, ROUGH, STEPS_CENSORED
from jaxscan.images.stripes.settle import Looked, Places, replaced
from jaxscan.images.stripes.survey import LEAST_SIGNAL
from jaxscan.images.stripes.windows import Sensor, gather_windows

# A peak below this multiple of the least strength is measured again in a longer window.
_FAINT = 2.0
_LEAST_STRENGTH = 10.0
# Beyond this part of the lines with a stripe it is burnt out all along it.
ALL_BURNT: Final = 0.75
# Lines are measured in groups of these sizes, whatever the image: few sizes are compiled. Large groups cost less per
# line, because two cores start together; the few lines that are measured again would not fill them.
GROUPS: Final = (4, 128), (20, 512)
_GROUPS_AGAIN: Final = (4, 64), (8, 512)
_FEW = 8


@dataclass(frozen=True)
class Looker:
    """Measures the windows about places of a batch.

    Attributes:
        batch: the photographs.
        light: their light.
        detector: which.
        ground: the noise of each frame.
        least: how much a stripe must stand out in each frame.
        all_burnt: in which frames with full pixels that are numbers the stripe is burnt out all along: noise that is
            read off burnt-out lines of a JPEG is no measure for those few between that are not.
        ln_light: ln of the stripe's light in each line, at first sight.
        seen: which lines had a whole stripe then that is not burnt out.
    """

    batch: Batch
    light: Light
    detector: Detector
    ground: Float[np.ndarray, "count"]
    least: Float[np.ndarray, "count"]
    all_burnt: Bool[np.ndarray, "count"]
    ln_light: Float[np.ndarray, "count lines"]
    seen: Bool[np.ndarray, "count lines"]

    @staticmethod
    def create(batch: Batch, light: Light, detector: Detector) -> "Looker":
        """Before anything is measured."""
        ground = np.asarray(light.sensor.ground)[: batch.count]
        least = np.maximum(LEAST_SIGNAL * ground, _LEAST_STRENGTH)
        nothing = np.zeros(batch.peak.shape, bool)
        return Looker(batch, light, detector, ground, least, nothing[:, 0], nothing.astype(np.float32), nothing)

    def everywhere(self) -> tuple["Looker", Looked]:
        """What is in each line, and who looks further: a first look tells of the light and of burnt-out stripes too."""
        shape, cut = self.batch.peak.shape, self.light.cut[: self.batch.count]
        at = places_of(self.batch.peak)
        begun = self._first_look(at)
        first = jax.tree.map(lambda x: x.reshape(shape), begun[0])
        shines = first.relief > self.least[:, None]
        knowing = replace(
            self,
            all_burnt=cut & ((first.burnt & shines).sum(1) > ALL_BURNT * shines.sum(1)),
            ln_light=first.ln_light,
            seen=first.whole & ~first.burnt & shines,
        )
        if self.detector == "likelihood":
            knowing = knowing.with_light(self.light)
        return knowing, jax.tree.map(lambda x: x.reshape(shape), knowing._looked(at, begun))

    def with_light(self, light: Light) -> "Looker":
        """The same in other light, with the speckle in it that is seen along the stripe."""
        return replace(self, light=light.with_grain(self.ln_light, self.seen))

    def with_sensor(self, **known: Any) -> "Looker":
        """The same with other numbers of the frames' sensors."""
        return replace(self, light=replace(self.light, sensor=replace(self.light.sensor, **known)))

    def at(self, places: Places) -> Looked:
        """What is at some places."""
        return self._looked(places, self._first_look(places))

    def again_in(self, looked: Looked, peak: Int[np.ndarray, "count lines"], frames: np.ndarray) -> Looked:
        """`Looked` with all lines of some frames measured again."""
        found = self.at(places_of(peak, frames)).measured
        shape = -1, peak.shape[1]
        return looked._replace(
            measured=jax.tree.map(lambda old, new: replaced(old, frames, new.reshape(shape)), looked.measured, found)
        )

    def again(
        self,
        measured: Any,
        at: Places,
        which: np.ndarray,
        half: int,
        model: Model,
        steps: int | None = None,
    ) -> Any:
        """`Measured` with another model in some lines."""
        if not which.any():
            return measured
        found = self._measured(tuple(index[which] for index in at), half, model, steps)
        # Where there is no edge in the stripe, or no step beside it, what was measured without one stands.
        taken = found.whole if model in OF_SOMETHING_MORE else np.ones_like(found.whole)
        places = np.flatnonzero(which)[taken]
        return jax.tree.map(lambda old, new: replaced(old, places, new[taken]), measured, found)

    def beside_stray_light(self, measured: Any, at: Places, which: np.ndarray) -> Any:
        """`Measured` of lines that are not burnt out, where other light falls beside some of them."""
        grained, rough = _speckled(self.light.sensor, at[0], measured.relief)
        models: tuple[tuple[np.ndarray, Model], ...] = (
            (~(grained | rough), "plain in stray light"),
            (grained & ~rough, "grained in stray light"),
            (rough, "grained and censored in stray light"),
        )
        for lines, model in models:
            measured = self.again(measured, at, which & lines, NARROW, model)
        return measured

    def _measured(self, at: Places, half: int, model: Model, steps: int | None = None) -> Any:
        """`Measured` of the windows at these places, in NumPy's arrays; in groups, for each size compiles again."""
        batch, here, found = self.batch, self._sensor_for(model), []
        color, columns = batch.settings.color, batch.settings.columns
        for (frame, line, peak), count in groups(*at, sizes=GROUPS if model == "plain" else _GROUPS_AGAIN):
            places = frame, line, peak, color, columns, batch.half(half)
            windows = gather_windows(batch.images, batch.background, here, *places, model == "in texture")
            measured = measure(windows, here, frame, self.detector, model, steps)
            found.append(jax.tree.map(lambda x, n=count: np.ravel(x)[:n], measured))
        return found[0] if len(found) == 1 else jax.tree.map(lambda *parts: np.concatenate(parts), *found)

    def _sensor_for(self, model: Model) -> Sensor:
        sensor, cut = self.light.sensor, self.light.cut
        if model == "edge":
            # An edge of reflectance is looked for in the pixels as they are.
            return replace(sensor, smooth=None)
        return replace(sensor, cut=cut) if model == "censored" and cut.any() else sensor

    def _first_look(self, at: Places) -> tuple[Any, np.ndarray]:
        """In short windows where the frame's stripe is slim, else in narrow ones; and where that is."""
        slim = self.light.slim[at[0]]
        if slim.all() or not slim.any():
            return self._measured(at, SHORT if slim.all() else NARROW, "plain"), slim
        each = [
            self._measured(tuple(index[which] for index in at), half, "plain")
            for which, half in ((slim, SHORT), (~slim, NARROW))
        ]
        order = np.argsort(np.concatenate([np.flatnonzero(slim), np.flatnonzero(~slim)]))
        return jax.tree.map(lambda *parts: np.concatenate(parts)[order], *each), slim

    def _looked(self, at: Places, begun: tuple[Any, np.ndarray]) -> Looked:
        """With further looks where the first one, which is given, is not enough."""
        measured, slim = begun
        least = self.least[at[0]]
        # In noise a longer window has a lower lowest point, by which what is faint stands out.
        doubtful = measured.cramped & (measured.relief > least) | (measured.strength < _FAINT * least)
        measured = self.again(measured, at, slim & doubtful, NARROW, "plain")
        slim = slim & ~doubtful
        # A window inside a burnt-out stripe sees no background, but it sees one end of it.
        strong = (measured.relief > least) | (measured.cramped & measured.burnt)
        cramped = measured.cramped & strong & (self.batch.half(WIDE) > self.batch.half(NARROW))
        burnt = measured.burnt & strong & ~cramped
        if self.detector != "likelihood":
            return Looked(self.again(measured, at, cramped, WIDE, "plain"), strong, cramped, burnt)
        as_burnt = burnt | self.all_burnt[at[0]] & strong & ~cramped
        grained, rough = (strong & each for each in _speckled(self.light.sensor, at[0], measured.relief))
        # What a JPEG leaves hides speckle in burnt-out lines.
        plain, even = measured, ~(grained | rough)
        even |= self.light.cut[at[0]] & measured.burnt | self.all_burnt[at[0]]
        measured = self._burnt(measured, at, cramped & even, WIDE)
        measured = self._burnt(measured, at, as_burnt & even & ~slim, NARROW)
        measured = self._burnt(measured, at, as_burnt & even & slim, SHORT)
        measured = self.again(measured, at, cramped & ~even, WIDE, "grained and censored")
        again = (rough | grained & burnt) & ~(cramped | even)
        measured = self.again(measured, at, again, NARROW, "grained and censored")
        measured = self.again(measured, at, grained & ~(rough | as_burnt | cramped), NARROW, "grained")
        # Whether there is an edge is asked of the plain fit.
        measured = replace(measured, strained=plain.strained, h3=plain.h3, h4=plain.h4, stray=plain.stray)
        asked = measured.textured & strong & ~(as_burnt | measured.burnt)
        return Looked(self._in_texture(measured, at, asked), strong, cramped, burnt)

    def _in_texture(self, measured: Any, at: Places, which: np.ndarray) -> Any:
        """`Measured` of lines whose surface has a texture; where that is all that stands out, there is no stripe."""
        if not which.any():
            return measured
        found = self._measured(tuple(index[which] for index in at), NARROW, "in texture")
        places = np.flatnonzero(which)
        taken = jax.tree.map(lambda old, new: replaced(old, places[found.whole], new[found.whole]), measured, found)
        # How bright a stripe is was known before, and nothing more is asked of it.
        kept = {name: getattr(measured, name) for name in ("relief", "breadth", "ln_light", "textured")}
        uneven, none = np.array(measured.uneven), np.zeros_like(which)
        uneven[places[found.whole]] = 0.0
        none[places[found.of_surface]] = True
        return replace(taken, **kept, uneven=uneven, whole=taken.whole & ~none)

    def _burnt(self, measured: Any, at: Places, which: np.ndarray, half: int) -> Any:
        """In few steps, which do for most; a group of lines takes as many as the slowest of them."""
        measured = self.again(measured, at, which, half, "censored", FEW_STEPS_CENSORED)
        return self.again(measured, at, which & ~measured.settled, half, "censored", STEPS_CENSORED)


def places_of(peak: Int[np.ndarray, "frames lines"], frames: Bool[np.ndarray, "frames"] | None = None) -> Places:
    """Frame, line and row of each line's peak, of some frames or of all."""
    at = tuple(index.ravel() for index in (*np.indices(peak.shape, np.int32), peak))
    return at if frames is None else tuple(index[np.repeat(frames, peak.shape[1])] for index in at)


def _speckled(
    sensor: Sensor, frame: Int[np.ndarray, "lines"], relief: Float[np.ndarray, "lines"]
) -> tuple[Bool[np.ndarray, "lines"], Bool[np.ndarray, "lines"]]:
    """Which lines have speckle of several pixels, and which have so much that it makes them ragged.

    Either only where it counts beside the sensor's noise.
    """
    speckle, grain, read = (np.asarray(x)[frame] for x in (sensor.speckle, sensor.grain, sensor.read))
    counts = speckle * relief**2 > read**2
    return counts & (grain > 0), counts & (speckle > ROUGH)


def groups(
    *at: Int[np.ndarray, "some"], sizes: tuple[tuple[int, int], tuple[int, int]]
) -> Iterator[tuple[list[Int[np.ndarray, "groups lines"]], int]]:
    """The indices in groups of one of two shapes, the last one filled up by repetition; and how many of each count."""
    first, some, (small, large) = 0, len(at[0]), sizes
    while first < some:
        # A few small ones take less time than one large one that is almost empty.
        shape = large if some - first > _FEW * prod(small) else small
        count = min(prod(shape), some - first)
        yield [np.resize(index[first : first + count], shape).astype(np.int32, copy=False) for index in at], count
        first += count
