"""The rig: what calibration finds and reconstruction uses."""

import equinox as eqx
import jax
from jaxtyping import Array, Float

from jaxscan.errors import InputError
from jaxscan.precision import Leaf
from jaxscan.rig.camera import Camera
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.stage import Stage
from jaxscan.rig.turntable import Turntable


class Rig(eqx.Module):
    """A camera, its lasers, the stage and the turntable.

    Attributes:
        camera: the camera.
        lasers: the light planes; none for a rig calibrated without a laser, several for several lasers.
        stage: the stage, or None for a rig without one.
        turntable: what turns the object between scans, or None.
    """

    camera: Camera
    lasers: tuple[LightPlane, ...] = ()
    stage: Stage | None = None
    turntable: Turntable | None = None

    def laser(self, name: str = "") -> LightPlane:
        """The light plane of a laser; without a name, the only one.

        Raises:
            InputError: there is no such laser, or more than one and no name.
        """
        if not self.lasers:
            raise InputError("the rig has no laser: calibrate it with photographs of the stripe on the board")
        chosen = [laser for laser in self.lasers if laser.name == name] if name else list(self.lasers)
        if len(chosen) != 1:
            names = ", ".join(f'"{laser.name}"' for laser in self.lasers)
            raise InputError(f'the rig has the lasers {names}; "{name}" names {len(chosen)} of them: name one')
        return chosen[0]

    def triangulate(self, pixel: Float[Array, "2"], steps: float | Leaf, laser: str = "") -> Float[Array, "3"]:
        """A stripe pixel (u, v) at a motor step count to the point of the object frame (mm).

        X = x / (ω · x) − n · per_step. The plain statement of what `reconstruction` does at speed; NaN where the
        pixel cannot see the sheet.
        """
        point = self.laser(laser).triangulate(self.camera.ray(pixel))
        return point if self.stage is None else point - self.stage.displacement(steps)


def parameter_names(rig: Rig) -> list[str]:
    """The names of the rig's leaves, in the order of its leaves: `camera.focal.0` … `stage.per_step.2`.

    A laser of several is named in between: `laser.left.plane.0`.
    """

    def name(path: tuple[jax.tree_util.KeyEntry, ...]) -> str:
        keys = [str(getattr(key, "name", getattr(key, "idx", ""))) for key in path]
        if keys[0] == "lasers":
            laser = rig.lasers[int(keys[1])].name
            keys[:2] = ["laser", laser] if laser else ["laser"]
        return ".".join(keys)

    return [name(path) for path, _ in jax.tree_util.tree_leaves_with_path(rig)]
