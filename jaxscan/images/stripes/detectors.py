"""The detectors, behind one interface: windows in; position, its σ, strength, width and validity of each line out."""

from collections.abc import Callable
from typing import Final, Literal

import equinox as eqx
import jax.numpy as jnp
import numpy as np
from jaxtyping import Array, Bool, Float, Int

from jaxscan.detectors import DETECTORS, Detector
from jaxscan.images.stripes import classical
from jaxscan.images.stripes.classical import Estimate
from jaxscan.images.stripes.likelihood import Misfit, likelihood
from jaxscan.images.stripes.reflectance_edge import fit_reflectance_edge
from jaxscan.images.stripes.step_fit import fit_beside_a_step, uneven
from jaxscan.images.stripes.texture_fit import fit_in_texture
from jaxscan.images.stripes.windows import Outline, Places, Sensor, Windows, bump, outline
from jaxscan.kept_programs import compiled

Model = Literal[
    "plain",
    "censored",
    "grained",
    "grained and censored",
    "edge",
    "beside a step",
    "in texture",
    "plain in stray light",
    "grained in stray light",
    "grained and censored in stray light",
]

# Models of something beside the stripe's own light: where it is not found, the plain one stands.
OF_SOMETHING_MORE: Final[tuple[Model, ...]] = ("edge", "beside a step", "in texture")

Measure = Callable[[Windows, Outline, Sensor], Estimate]

_CLOSED: Final[dict[str, Measure]] = {
    "gravity": classical.gravity,
    "derivative": classical.derivative,
    "ridge": classical.ridge,
    "gaussian": classical.gaussian,
    "parabola": classical.parabola,
    "threshold": classical.threshold,
}
# An outline at least this number of pixels from the window's end is not affected by it.
_MARGIN = 5
# A stripe falls on both sides to less than half.
_ONE_SIDED = 0.5
# Of a window that is fuller than this, the rest may be noise.
_MOSTLY_FULL = 0.5
# An outline determines a width to this accuracy; what is beyond is a core.
_THICKER = 1.25


def register_detector(name: str, words: str, measure: Measure) -> None:
    """Let stripes be measured in one more way.

    Args:
        name: for `detector=` and `--detector`.
        words: what it is, in words.
        measure: the centre of the stripe in each window, its σ and width, from windows, their outlines and the sensor;
            traced by JAX.
    """
    DETECTORS[name] = words
    _CLOSED[name] = measure


class Measured(eqx.Module):
    """What the windows show of the stripe, for each line.

    Attributes:
        position: the stripe's centre, rows (or columns).
        sigma: its predicted standard deviation, px.
        strength: its smoothed peak above the background, grey levels of the neutral response. Weights of a photograph
            without texture let neutral light through, and a shining rim would be a stripe.
        width: full width at half height, px.
        breadth: of what is seen, full at half height, px: of a stripe that is burnt out, with its full pixels.
        relief: height of the peak above the lowest point of the window, whatever lies between.
        whole: whether both its flanks are on the image and in the window, and a centre was found between them.
        cramped: whether a wider window would show more.
        burnt: whether some pixel of the window is full.
        strained: whether the pixels are off the detector's profile by more than noise: an edge of reflectance may run
            through it.
        h3: the third Gauss-Hermite coefficient of what the profile leaves, in parts of its height; 0 of other
            detectors.
        h4: the fourth.
        ln_light: ln of its height times its standard deviation; 0 of other detectors.
        settled: whether more steps of the fit would change nothing; true of other detectors.
        stray: whether light that is not the stripe's seems to fall beside it; false of other detectors.
        textured: whether its surface has a texture, as far as its colours show it.
        of_surface: whether texture is all that stands out, as the fit in texture shows it; false of other models.
        uneven: how much brighter the window's one end is than its other one, over the noise of that.
    """

    position: Float[Array, "groups lines"]
    sigma: Float[Array, "groups lines"]
    strength: Float[Array, "groups lines"]
    width: Float[Array, "groups lines"]
    breadth: Float[Array, "groups lines"]
    relief: Float[Array, "groups lines"]
    whole: Bool[Array, "groups lines"]
    cramped: Bool[Array, "groups lines"]
    burnt: Bool[Array, "groups lines"]
    strained: Bool[Array, "groups lines"]
    h3: Float[Array, "groups lines"]
    h4: Float[Array, "groups lines"]
    ln_light: Float[Array, "groups lines"]
    settled: Bool[Array, "groups lines"]
    stray: Bool[Array, "groups lines"]
    uneven: Float[Array, "groups lines"]
    textured: Bool[Array, "groups lines"]
    of_surface: Bool[Array, "groups lines"]

    @property
    def thickness(self) -> Float[np.ndarray, "groups lines"]:
        """How thick the stripe looks, px, of NumPy's arrays: its full width, or with its burnt-out core its breadth."""
        return np.where(self.burnt & (self.breadth > _THICKER * self.width), self.breadth, self.width)


def _textured(windows: Windows, sensor: Sensor) -> Bool[Array, "groups 1 lines"]:
    """Beside the stripe, or under it, whose light the other channels then must show as the laser's own does."""
    if windows.own is None or sensor.colours is None:
        return jnp.zeros_like(windows.full[:, :1])
    return windows.own.textured & sensor.colours.aligned


@compiled(static_argnames=("detector", "model"))
def measure(
    windows: Windows,
    sensor: Sensor,
    frame: Places,
    detector: Detector,
    model: Model = "plain",
    steps: Int[Array, ""] | None = None,
) -> Measured:
    """The stripe in each window.

    Args:
        windows: as `gather_windows` gives them.
        sensor: as `survey` gives it.
        frame: of each window.
        detector: which.
        model: of the profile, for the likelihood fit.
        steps: the most of that fit's steps; as many as the model may need by default.
    """
    r = windows.response
    size = r.shape[1]
    around, here = outline(r), sensor.of(frame)
    zero = jnp.zeros_like(around.top)
    no = jnp.zeros_like(around.whole)
    misfit, of_surface, shines = Misfit(no, zero, zero, zero, ~no, no), no, None
    if model == "edge":
        found = fit_reflectance_edge(windows, around, here)
    elif model == "beside a step":
        found = fit_beside_a_step(windows, around, here)
    elif model == "in texture":
        found, shines, of_surface = fit_in_texture(windows, around, here)
    elif detector == "likelihood":
        traits = (trait in model for trait in ("censored", "grained", "stray"))
        found, misfit = likelihood(windows, around, here, *traits, steps=steps)
    else:
        found = _CLOSED[detector](windows, around, here)
    seen = around if windows.neutral is None else bump(windows.neutral if shines is None else shines)
    # Where an edge runs through a stripe its centre may lie on the dark side, below half the height of what is seen.
    between = (found.centre > around.start) & (found.centre < around.end) | (model in OF_SOMETHING_MORE)
    whole = found.found & between & (around.whole | (model == "in texture"))
    relief = around.top - r.min(1, keepdims=True)
    cramped = (around.start < _MARGIN) | (around.end >= size - _MARGIN)
    # Inside a burnt-out stripe noise is a peak, with the window's lowest point on one side only.
    cramped |= windows.full.any(1, keepdims=True) & (around.top - around.floor < _ONE_SIDED * relief)
    cramped |= windows.full.mean(1, keepdims=True) > _MOSTLY_FULL
    return Measured(
        position=windows.first.astype(r.dtype) + found.centre[:, 0],
        sigma=found.sigma[:, 0],
        strength=(seen.top - seen.floor)[:, 0],
        width=found.width[:, 0],
        breadth=around.width[:, 0],
        relief=relief[:, 0],
        whole=whole[:, 0],
        cramped=cramped[:, 0],
        burnt=windows.full.any(1),
        strained=misfit.strained[:, 0],
        h3=misfit.h3[:, 0],
        h4=misfit.h4[:, 0],
        ln_light=misfit.ln_light[:, 0],
        settled=misfit.settled[:, 0],
        stray=misfit.stray[:, 0],
        uneven=uneven(windows, here)[:, 0],
        textured=_textured(windows, here)[:, 0],
        of_surface=of_surface[:, 0],
    )
