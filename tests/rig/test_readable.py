"""What a rig looks like when it is printed: numbers and units, whatever its parts, and under a transformation."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from jaxscan.rig import Camera, Covariance, Rig
from jaxscan.rig.bowed_sheet import BowedSheet
from jaxscan.rig.light_plane import LightPlane
from jaxscan.rig.linear import Linear
from jaxscan.rig.motion import Chain
from jaxscan.rig.rotary import Rotary

CAMERA = Camera.create((640, 480), (701.25, 699.5), (320.5, 241.0), "brown", [-0.125, 0.25, 0.0], [0.001, 0.002])


def test_a_rig_has_a_line_for_each_part_with_numbers_and_units():
    motion = Chain((Linear.create([0.0, 0.001, 0.0]), Rotary.create([0.0, 0.0157, 0.0], [1.25, 0.0, 331.0])))
    rig = Rig(CAMERA, (LightPlane.create([0.0, -0.00494, 0.00303], "left"),), motion)
    assert str(rig).splitlines() == [
        "Rig(",
        "    Camera(focal 701.25 699.5 px, principal 320.5 241 px, Brown(radial -0.125 0.25 0, tangential "
        "0.001 0.002), image_size 640 480 px),",
        '    LightPlane(plane 0 -0.00494 0.00303 1/mm, name "left"),',
        '    Linear(per_step 0 0.001 0 mm, axis "stage"),',
        '    Rotary(per_step 0 0.0157 0 rad, centre 1.25 0 331 mm, axis "turntable"),',
        ")",
    ]


@pytest.mark.parametrize(
    ("part", "said"),
    [
        (BowedSheet.create([0.0, 0.002, 0.003], 0.5), "BowedSheet(plane 0 0.002 0.003 1/mm, bow 0.5 mm)"),
        (Camera.create((64, 48), (70.0, 70.0), (31.5, 23.5), "splined"), "shift_x of "),
        (Camera.create((64, 48), (70.0, 70.0), (31.5, 23.5), tilt=(0.01, 0.0)), "tilt 0.01 0 rad"),
        (Camera.create((64, 48), (70.0, 70.0), (31.5, 23.5)), "Undistorted()"),
        (
            Covariance(("camera.focal.0", "camera.focal.1"), np.eye(2)),
            "(2 parameters, camera.focal.0 to camera.focal.1)",
        ),
        (Covariance((), np.zeros((0, 0))), "Covariance(0 parameters)"),
    ],
)
def test_parts_by_themselves(part: object, said: str):
    assert said in repr(part)


def test_without_numbers_there_is_a_text_too():
    said = []

    def traced(camera: Camera) -> jax.Array:
        said.append(repr(camera))
        return camera.focal[0]

    jax.make_jaxpr(traced)(CAMERA)
    assert said[0].startswith("Camera(")
    assert repr(jax.tree.map(lambda leaf: jnp.stack([leaf, leaf]), CAMERA)).startswith("Camera(")
    assert repr(jax.tree.map(lambda leaf: None, CAMERA)).startswith("Camera(")
