"""How well a point can be known where the light is a laser's: the uncertainty that speckle alone leaves.

Coherent light that a rough surface scatters forms speckles, whose places are chance. A camera that sees a point under
the angle u of half its aperture, and the sheet under the triangulation angle θ, knows its distance to no better than

    δz = C λ / (2π sin u sin θ)

with the wavelength λ and the speckle's contrast C (R. Dorsch, G. Häusler and J. Herrmann, *Laser triangulation:
fundamental uncertainty in distance measurement*, Applied Optics 33, 1994, 1306-1314).
"""

from dataclasses import dataclass
from typing import Final

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.rig.rig import Rig


@dataclass(frozen=True)
class Plausible:
    """The numbers that a quantity of lens, laser and sensor has.

    Attributes:
        least: the least of them.
        most: the most.
        words: which these are, and in which unit.
        slips: by which factors a number is off that was given in another unit.
    """

    least: float
    most: float
    words: str
    slips: tuple[float, ...] = ()

    def refusal(self, value: float) -> str | None:
        """Why a value is none of them, and which was likely meant; None for one that is."""
        if self._takes(value):
            return None
        # An f-number is given as 1:8 too; of the others a slip of the unit is likelier.
        others = [value * slip for slip in self.slips] if self.slips else [1 / value] if 0 < value < 1 else []
        meant = next((f"; did you mean {other:.4g}?" for other in others if self._takes(other)), "")
        return self.words + meant

    def _takes(self, value: float) -> bool:
        return self.least <= value <= self.most


# Lasers from the ultraviolet to the infrared; the slips are of metres, millimetres, micrometres and ångströms.
PLAUSIBLE: Final = {
    "f_number": Plausible(0.5, 64.0, "focal length over the aperture's diameter is 0.5 to 64"),
    "wavelength_nm": Plausible(
        200.0, 2000.0, "in nanometres a laser has 200 to 2000, a visible one 380 to 780", (1e9, 1e6, 1e3, 0.1)
    ),
    "pixel_um": Plausible(0.5, 50.0, "in micrometres a pixel is 0.5 to 50 wide", (1e6, 1e3, 1e-3)),
}


@dataclass(frozen=True)
class Optics:
    """What a rig does not know of its lens and its laser.

    Attributes:
        f_number: focal length over the aperture's diameter.
        wavelength_nm: of the laser, nm.
        pixel_um: pitch of the sensor's pixels, µm.
    """

    f_number: float
    wavelength_nm: float
    pixel_um: float

    def __post_init__(self) -> None:
        """Refuse what no lens, laser or sensor has.

        Raises:
            InputError: a number that is not plausible, of a wrong unit for one.
        """
        for name, plausible in PLAUSIBLE.items():
            if refusal := plausible.refusal(value := getattr(self, name)):
                raise InputError(f"{name} = {value:g}: {refusal}")


@dataclass(frozen=True)
class SpeckleLimit:
    """What speckle alone leaves of some points, and how near they come to it.

    Attributes:
        contrast: of the speckle as the pixels see it.
        limit_mm: δz in their median.
        sigma_pixel_mm: σ along their rays from the pixel alone, in their median.
    """

    contrast: float
    limit_mm: float
    sigma_pixel_mm: float

    @property
    def times(self) -> float:
        """How many times the limit the pixel's part of σ is."""
        return self.sigma_pixel_mm / self.limit_mm

    def in_words(self) -> str:
        """The limit, and how near the points come to it."""
        return (
            f"{self.limit_mm:.4f} mm at a contrast of {self.contrast:.2f} (Dorsch, Häusler, Herrmann 1994); "
            f"the pixel's part of σ is {self.sigma_pixel_mm:.4f} mm, {self.times:.2g} times that"
        )


def uncertainty(contrast: float, wavelength_mm: float, sin_u: np.ndarray, sin_theta: np.ndarray) -> np.ndarray:
    """δz in mm, by the formula of Dorsch, Häusler and Herrmann."""
    return contrast * wavelength_mm / (2 * np.pi * sin_u * sin_theta)


def speckle_limit(
    rig: Rig, points: Float[np.ndarray, "points 3"], optics: Optics, contrast: float = 1.0
) -> Float[np.ndarray, "points"]:
    """δz of points on a light sheet, mm.

    Args:
        rig: whose camera sees them; of several lasers that is meant whose sheet they lie nearest to.
        points: camera frame, mm.
        optics: of its lens and laser.
        contrast: of the speckle as the pixels see it; 1 is a pattern that they resolve.

    Raises:
        InputError: the rig has no laser.
    """
    if not rig.lights:
        raise InputError("the rig has no laser: give the rig that the points were reconstructed with")
    light = min(rig.lights, key=lambda light: float(np.median(np.abs(light.level(points)))))
    normal = np.asarray(light.gradient(points))
    distance = np.linalg.norm(points, axis=1)
    focal_mm = float(np.mean([float(f) for f in rig.camera.focal])) * optics.pixel_um / 1000
    radius = focal_mm / optics.f_number / 2
    sin_theta = np.abs((points * normal).sum(axis=1)) / (distance * np.linalg.norm(normal, axis=1))
    return uncertainty(contrast, optics.wavelength_nm * 1e-6, radius / np.hypot(radius, distance), sin_theta)


def limit_of(
    rig: Rig,
    points: Float[np.ndarray, "points 3"],
    optics: Optics,
    contrast: float | None,
    sigma_pixel_mm: float,
) -> SpeckleLimit:
    """How near points come to what speckle alone leaves of them, as `speckle_limit`; a contrast not known counts as 1.

    Raises:
        InputError: the rig has no laser.
    """
    contrast = contrast or 1.0
    return SpeckleLimit(contrast, float(np.median(speckle_limit(rig, points, optics, contrast))), sigma_pixel_mm)
