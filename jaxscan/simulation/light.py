"""Light and sensor: what makes a photograph bright, and what makes numbers of it."""

import math
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.simulation.laser_profiles import bells

# Grains of more pixels than this are no speckle.
_LONGEST_PX = 50.0


@dataclass(frozen=True)
class Lighting:
    """What lights the scene. Light levels are grey levels of an 8-bit photograph, of a white surface facing the light.

    Attributes:
        ambient: light from everywhere, without shadows.
        directional: light from one direction, a lamp, without shadows.
        direction: towards that lamp, camera frame; need not have length one.
        ambient_colour: red, green and blue of both, in parts of their level; (1, 0.75, 0.45) is about tungsten.
        highlight: brightest level of the lamp's reflection in a glossy body.
        highlight_deg: how far a glossy surface may be turned from a mirror of the lamp, standard deviation, degrees.
        laser_power: peak of the sheet on a surface that faces the laser, before any blur.
        laser_colour: red, green and blue of the laser, in parts of its power.
        sheet_sigma_mm: standard deviation of the sheet's Gaussian thickness, mm; other profiles scale with it.
        laser_profile: the sheet's cross-section, one of `LASER_PROFILES`; its centre of gravity is in the plane.
        laser_source: where the sheet fans out from, camera frame, mm; None for `default_source`.
        laser_fan_mm: distance from there at which the sheet has its power; it is weaker in proportion farther away, as
            its light spreads over a longer line. None: as bright everywhere.
        speckle: contrast of the laser's light in the pixels of the photograph, 0 to 1 (standard deviation over mean).
        speckle_length_px: along the stripe and across it: distance at which the correlation of that light has fallen to
            1/√e, px; 0 where each pixel is by itself.
        ghost: brightness of a second image of the laser's light, in parts of the first. Lens and filter reflect it: it
            is turned half around the middle of the photograph.
    """

    ambient: float = 55.0
    directional: float = 35.0
    direction: tuple[float, float, float] = (-0.3, -0.5, -1.0)
    ambient_colour: tuple[float, float, float] = (1.0, 1.0, 1.0)
    highlight: float = 0.0
    highlight_deg: float = 1.5
    laser_power: float = 2000.0
    laser_colour: tuple[float, float, float] = (1.0, 0.006, 0.006)
    sheet_sigma_mm: float = 0.25
    laser_profile: str = "gaussian"
    laser_source: tuple[float, float, float] | None = None
    laser_fan_mm: float | None = None
    speckle: float = 0.0
    speckle_length_px: tuple[float, float] = (0.0, 0.0)
    ghost: float = 0.0

    def __post_init__(self) -> None:
        """Refuse what no light can be.

        Raises:
            InputError: a level, contrast, thickness or profile that cannot be.
        """
        for name in ("ambient", "directional", "highlight", "laser_power"):
            if not 0 <= getattr(self, name) < math.inf:
                raise InputError(f"{name} = {getattr(self, name)}: give a light level of 0 or more, in grey levels")
        if not all(0 <= part < math.inf for part in self.laser_colour):
            raise InputError(f"laser_colour = {self.laser_colour}: give three numbers of 0 or more")
        if not all(0 <= part <= 1 for part in self.ambient_colour):
            raise InputError(f"ambient_colour = {self.ambient_colour}: give three numbers from 0 to 1")
        if not 0 < self.highlight_deg <= 90:
            raise InputError(f"highlight_deg = {self.highlight_deg}: give an angle above 0 and up to 90 degrees")
        if not 0 < self.sheet_sigma_mm < math.inf:
            raise InputError(f"sheet_sigma_mm = {self.sheet_sigma_mm}: give a positive number of millimetres")
        if self.laser_fan_mm is not None and not 0 < self.laser_fan_mm < math.inf:
            raise InputError(f"laser_fan_mm = {self.laser_fan_mm}: give a positive number of millimetres, or None")
        bells(self.laser_profile)
        if not 0 <= self.speckle <= 1:
            raise InputError(f"speckle = {self.speckle}: give a contrast from 0 to 1")
        if not all(0 <= length <= _LONGEST_PX for length in self.speckle_length_px):
            raise InputError(
                f"speckle_length_px = {self.speckle_length_px}: give 0 to {_LONGEST_PX:g} pixels along the stripe, "
                "and across it"
            )
        if not 0 <= self.ghost <= 1:
            raise InputError(f"ghost = {self.ghost}: give a part of the stripe's brightness, 0 to 1")

    def source(self, omega: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
        """Where the sheet with dual plane ω fans out from (mm, camera frame)."""
        return default_source(omega) if self.laser_source is None else np.asarray(self.laser_source, np.float64)


@dataclass(frozen=True)
class Sensor:
    """From light to numbers.

    Attributes:
        blur_px: standard deviation of the lens's Gaussian point spread, px.
        noise: standard deviation of the noise in grey levels, equal everywhere and independent.
        gain: grey levels for one unit of light.
        bits: 8 or 16 bits a channel; a 16-bit photograph has 257 numbers for each grey level.
        saturation: grey level above which the detector is full, at most 255.
        mosaic: whether each pixel sees one colour, the others being interpolated.
    """

    blur_px: float = 0.6
    noise: float = 2.0
    gain: float = 1.0
    bits: int = 8
    saturation: float = 255.0
    mosaic: bool = False

    def __post_init__(self) -> None:
        """Refuse what no sensor can be.

        Raises:
            InputError: a value out of its range.
        """
        if self.bits not in (8, 16):
            raise InputError(f"bits = {self.bits}: a photograph has 8 or 16 bits a channel")
        if not 0 <= self.blur_px <= 10:
            raise InputError(f"blur_px = {self.blur_px}: give 0 to 10 pixels")
        if not 0 <= self.noise <= 255:
            raise InputError(f"noise = {self.noise}: give 0 to 255 grey levels")
        if not 0 < self.gain < math.inf or not 0 < self.saturation <= 255:
            raise InputError(f"{self}: gain is positive, saturation is in 0 … 255")


def default_source(omega: Float[np.ndarray, "3"]) -> Float[np.ndarray, "3"]:
    """The point of the sheet on the camera's own u or v axis, whichever it crosses nearer (mm).

    A laser mounted beside or above the camera. From there its rays run along the image columns (or rows) of a lens
    without distortion, so that a column sees one lit point at most.
    """
    axis = int(np.argmax(np.abs(omega[:2])))
    source = np.zeros(3)
    source[axis] = 1 / omega[axis]
    return source
