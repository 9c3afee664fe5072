"""Which of the camera's parameters keep their value, and at what."""

from collections.abc import Sequence

from jaxscan.errors import InputError
from jaxscan.rig.camera import camera_parameters, lens_parameters

PRINCIPAL_POINT = ("camera.principal.0", "camera.principal.1")
_TILT = {"camera.tilt.0", "camera.tilt.1"}


def held_parameters(
    hold: Sequence[str], lens: str, principal_point: str, *, has_start: bool, tilted: bool = False
) -> set[str]:
    """The names of the parameters that are not refined.

    Args:
        hold: the names asked for.
        lens: the camera's.
        principal_point: "free" or "centre".
        has_start: whether there is a camera whose values they can keep. Without one a lens term is held at 0.
        tilted: whether the tilt of its sensor is among its parameters.

    Raises:
        InputError: a name that the camera does not have, or whose value is not known; a tilt that is sought with a
            lens that does not distort.
    """
    if principal_point not in ("free", "centre"):
        raise InputError(f'principal_point is "{principal_point}": use "free" or "centre"')
    known = camera_parameters(lens, tilted=tilted)
    if unknown := [name for name in hold if name not in known]:
        beyond = "" if unknown[0].startswith("camera.") else "only the camera can be held; "
        raise InputError(
            f'hold names {", ".join(unknown)}: {beyond}a camera with the lens "{lens}" has {", ".join(known)}'
        )
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
