"""Edges of reflectance that run along a stripe: where the lines give evidence for one, they are measured with it."""

from typing import Any, NamedTuple

import jax
import numpy as np
from jaxtyping import Bool, Int

from jaxscan.images.stripes.batch import NARROW
from jaxscan.images.stripes.evidence import edges_and_profiles
from jaxscan.images.stripes.look import ALL_BURNT, Looker, places_of
from jaxscan.images.stripes.noise_again import can_be_torn, without_halo
from jaxscan.images.stripes.settle import Looked


class WithEdges(NamedTuple):
    """Lines that were looked at for edges.

    Attributes:
        measured: `Measured` of all lines.
        with_edge: which were measured with an edge.
        odd: in which frames the stripe is no bell.
    """

    measured: Any
    with_edge: Bool[np.ndarray, "frames lines"]
    odd: Bool[np.ndarray, "frames"]


def with_edges(looker: Looker, looked: Looked, peak: Int[np.ndarray, "frames lines"]) -> WithEdges:
    """Measure lines again through which an edge runs.

    Args:
        looker: who has looked.
        looked: what was found in each line.
        peak: where.
    """
    count, measured = len(peak), looked.measured
    plain = without_halo(looked)
    strained, odd = edges_and_profiles(measured.h3, measured.h4, plain, plain & measured.strained)
    # The shapes that a video's coding leaves are no edges.
    strained &= can_be_torn(looker)[:, None] & ~looker.light.video[:count, None]
    # A stripe that is burnt out over its whole length is judged by its flanks.
    mostly = (looked.burnt & looked.strong).sum(1) > ALL_BURNT * np.maximum(looked.strong.sum(1), 1)
    odd |= mostly & ~np.asarray(looker.light.sensor.apart)[:count] | looker.light.no_bell()[:count]
    flat, at = jax.tree.map(np.ravel, measured), places_of(peak)
    flat = looker.again(flat, at, strained.ravel(), NARROW, "edge")
    flat = jax.tree.map(lambda x: x.reshape(peak.shape), flat)
    return WithEdges(flat, flat.position != measured.position, odd)
