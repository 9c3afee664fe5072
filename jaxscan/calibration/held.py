"""Which of the rig's parameters keep their value, and at what."""

from collections.abc import Collection, Sequence

import jax

from jaxscan.errors import InputError
from jaxscan.precision import as_float64
from jaxscan.rig import Rig
from jaxscan.rig.camera import camera_parameters, lens_parameters
from jaxscan.rig.rig import parameter_names

PRINCIPAL_POINT = ("camera.principal.0", "camera.principal.1")
_TILT = {"camera.tilt.0", "camera.tilt.1"}


def held_parameters(
    hold: Sequence[str],
    lens: str,
    principal_point: str,
    *,
    has_start: bool,
    tilted: bool = False,
    beyond: Collection[str] = (),
) -> set[str]:
    """The names of the parameters that are not refined.

    Args:
        hold: the names asked for.
        lens: the camera's.
        principal_point: "free" or "centre".
        has_start: whether there is a camera whose values they can keep. Without one a lens term is held at 0.
        tilted: whether the tilt of its sensor is among its parameters.
        beyond: the parameters of lights and motion whose values are known.

    Raises:
        InputError: a name that the camera does not have, or whose value is not known; a tilt that is sought with a
            lens that does not distort.
    """
    if principal_point not in ("free", "centre"):
        raise InputError(f'principal_point is "{principal_point}": use "free" or "centre"')
    known = camera_parameters(lens, tilted=tilted)
    if unknown := [name for name in hold if name not in known and name not in beyond]:
        of_camera = f'a camera with the lens "{lens}" has {", ".join(known)}'
        if unknown[0].startswith("camera."):
            raise InputError(f"hold names {', '.join(unknown)}: {of_camera}")
        if not beyond:
            raise InputError(
                f"hold names {', '.join(unknown)}, but there is no rig whose value it could keep: give one to start "
                f"from, start= a Rig in Python, --camera rig.json on the command line; {of_camera}"
            )
        raise InputError(f"hold names {', '.join(unknown)}: the rig to start from has {', '.join(beyond)}; {of_camera}")
    centred = set(PRINCIPAL_POINT) if principal_point == "centre" else set()
    if not has_start:
        for name in set(hold) - centred:
            if name in PRINCIPAL_POINT:
                raise InputError(
                    f'hold names {name}, but there is no start whose value it could keep: principal_point = "centre" '
                    "holds it at the centre of the image; for another place give a camera to start from"
                )
            if name.startswith("camera.focal"):
                raise InputError(
                    f"hold names {name}, but there is no start whose value it could keep: give a camera to start from, "
                    "start=Camera.create(...) in Python, --camera FILE on the command line"
                )
    # Without a start these stay 0.
    zeros = () if has_start else hold
    if tilted and not set(hold) >= _TILT and set(lens_parameters(lens)) <= set(zeros):
        raise InputError(
            "a lens without distortion does not show where its axis is, so the tilt of the sensor cannot be "
            'distinguished from the principal point: ask for lens = "radial1" or a richer one, none of its terms '
            "held at 0, or leave out the tilt"
        )
    return set(hold) | centred


def parameters_beyond_camera(rig: Rig) -> list[str]:
    """The names of the parameters of a rig's lights and motion."""
    return [name for name in parameter_names(rig) if not name.startswith("camera.")]


def with_held_values(rig: Rig, start: Rig, hold: Collection[str]) -> Rig:
    """A rig with the values that another has for parameters of lights and motion.

    Args:
        rig: what is sought.
        start: with the values.
        hold: the names; those of the camera are left as they are.

    Raises:
        InputError: the rig has no such parameter: its light or its axis is of another kind.
    """
    wanted = [name for name in hold if not name.startswith("camera.")]
    names = parameter_names(rig)
    if missing := [name for name in wanted if name not in names]:
        raise InputError(
            f"hold names {', '.join(missing)}, which the rig that is sought does not have: it has "
            f"{', '.join(parameters_beyond_camera(rig))}; ask for light and motion of the kinds that the rig to start "
            "from has"
        )
    known = dict(zip(parameter_names(start), jax.tree.leaves(start), strict=True))
    leaves, structure = jax.tree.flatten(rig)
    held = [as_float64(known[name]) if name in wanted else leaf for name, leaf in zip(names, leaves, strict=True)]
    return jax.tree.unflatten(structure, held)
