"""Edges of reflectance that run along a stripe: where the lines give evidence for one, they are measured with it."""

from dataclasses import replace
from typing import Any, Final, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Float, Int

from jaxscan.images.stripes.batch import NARROW
from jaxscan.images.stripes.evidence import edges_and_profiles, mostly_torn
from jaxscan.images.stripes.light import MOSTLY_BURNT
from jaxscan.images.stripes.likelihood import FWHM
from jaxscan.images.stripes.look import ALL_BURNT, Looker, places_of
from jaxscan.images.stripes.settle import Looked
from jaxscan.images.stripes.stray_light import beside_stray_light

# ln of the standard deviation of the narrowest stripe in which an edge is measured, px.
_NARROWEST_TORN: Final = float(np.log(0.9))
# This part of the lines with an edge is narrower than the stripe.
_WHOLE: Final = 0.9


class WithEdges(NamedTuple):
    """Lines that were looked at for edges.

    Attributes:
        measured: `Measured` of all lines.
        with_edge: which were measured with an edge.
        odd: in which frames the stripe is no bell.
        looker: who knows of the light what lines without an edge show.
    """

    measured: Any
    with_edge: Bool[np.ndarray, "frames lines"]
    odd: Bool[np.ndarray, "frames"]
    looker: Looker


def with_edges(looker: Looker, looked: Looked, peak: Int[np.ndarray, "frames lines"]) -> WithEdges:
    """Measure lines again through which an edge runs.

    Args:
        looker: who has looked.
        looked: what was found in each line.
        peak: where.
    """
    count, measured = len(peak), looked.measured
    # The halo of a burnt-out stripe, and of lines nearly so beside it, strains the profile too, and is no edge.
    halo = looked.burnt | (looked.burnt.mean(axis=1, keepdims=True) > MOSTLY_BURNT)
    plain = looked.strong & ~looked.cramped & ~halo
    # What edges leave is taken for noise where most lines have one: it is read again off those that have least.
    misled, even = mostly_torn(measured.h3, measured.h4, plain & ~measured.stray)
    # What blurs a narrower stripe hides the shape that an edge leaves in it; a JPEG leaves such shapes of its own.
    broad = np.asarray(looker.light.sensor.ln_s)[:count] > _NARROWEST_TORN
    misled &= broad
    if misled.any():
        looker = looker.with_light(looker.light.read_again(looker.batch, misled[:, None] & ~even))
        looker = _of_whole_width(looker, measured.width, plain, misled)
        looked = beside_stray_light(looker, looker.again_in(looked, peak, misled), peak)
        measured = looked.measured
    strained, odd = edges_and_profiles(measured.h3, measured.h4, plain, plain & measured.strained)
    # The shapes that a video's coding leaves are no edges.
    strained &= broad[:, None] & ~looker.light.video[:count, None]
    # A stripe that is burnt out over its whole length is judged by its flanks.
    mostly = (looked.burnt & looked.strong).sum(1) > ALL_BURNT * np.maximum(looked.strong.sum(1), 1)
    odd |= mostly & ~np.asarray(looker.light.sensor.apart)[:count] | looker.light.no_bell()[:count]
    flat, at = jax.tree.map(np.ravel, measured), places_of(peak)
    for stray, lines in ((False, strained & ~measured.stray), (True, strained & measured.stray)):
        flat = looker.again(flat, at, lines.ravel(), NARROW, "edge", stray=stray)
    flat = jax.tree.map(lambda x: x.reshape(peak.shape), flat)
    return WithEdges(flat, flat.position != measured.position, odd, looker)


def _of_whole_width(
    looker: Looker,
    width: Float[np.ndarray, "frames lines"],
    seen: Bool[np.ndarray, "frames lines"],
    has_edge: Bool[np.ndarray, "frames"],
) -> Looker:
    """Where most lines of a frame have an edge, its usual width is the whole stripe's: an edge makes lines narrower."""
    sensor = looker.light.sensor
    ln_s = np.array(sensor.ln_s)
    for frame in np.flatnonzero(has_edge):
        ln_s[frame] = np.log(np.quantile(width[frame, seen[frame]], _WHOLE) / FWHM)
    return replace(looker, light=replace(looker.light, sensor=replace(sensor, ln_s=ln_s)))
