"""How well a point can be known where the light is a laser's: the uncertainty that speckle alone leaves.

Coherent light that a rough surface scatters forms speckles, whose places are chance. A camera that sees a point under
the angle u of half its aperture, and the sheet under the triangulation angle θ, knows its distance to no better than

    δz = C λ / (2π sin u sin θ)

with the wavelength λ and the speckle's contrast C (R. Dorsch, G. Häusler and J. Herrmann, *Laser triangulation:
fundamental uncertainty in distance measurement*, Applied Optics 33, 1994, 1306-1314).
"""

from dataclasses import dataclass
from math import isfinite

import numpy as np
from jaxtyping import Float

from jaxscan.errors import InputError
from jaxscan.rig.rig import Rig


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
        """Refuse what no lens or laser has.

        Raises:
            InputError: a number that is not positive.
        """
        for name in ("f_number", "wavelength_nm", "pixel_um"):
            value = getattr(self, name)
            if not (isfinite(value) and value > 0):
                raise InputError(f"{name} = {value}: give a positive number")


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
    if not rig.lasers:
        raise InputError("the rig has no laser: give the rig that the points were reconstructed with")
    planes = [np.asarray([float(c) for c in laser.plane]) for laser in rig.lasers]
    omega = min(planes, key=lambda plane: float(np.median(np.abs(points @ plane - 1))))
    distance = np.linalg.norm(points, axis=1)
    focal_mm = float(np.mean([float(f) for f in rig.camera.focal])) * optics.pixel_um / 1000
    radius = focal_mm / optics.f_number / 2
    sin_theta = np.abs(points @ omega) / (distance * np.linalg.norm(omega))
    return uncertainty(contrast, optics.wavelength_nm * 1e-6, radius / np.hypot(radius, distance), sin_theta)
