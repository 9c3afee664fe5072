"""What is said of a rig's lights and axes: a person's numbers, each with its σ where it is known."""

import math
from collections.abc import Iterator
from dataclasses import asdict
from typing import Any, Final

import numpy as np
from jaxtyping import Float

from jaxscan.geometry import vector_to_matrix
from jaxscan.rig.bowed_sheet import BowedSheet
from jaxscan.rig.covariance import Covariance
from jaxscan.rig.given_poses import CARRIED_BY, HeadPoses, ObjectPoses
from jaxscan.rig.guide import Screw, ScrewOnGuide
from jaxscan.rig.light import Light, inverse_depths, sheet_axes
from jaxscan.rig.light import distance as distance_from
from jaxscan.rig.line import Line
from jaxscan.rig.motion import AxisMotion
from jaxscan.rig.rig import Rig
from jaxscan.rig.rotary import Rotary
from jaxscan.rig.swept_sheet import SweptSheet
from jaxscan.rig.turn_summary import turn_summary

Summary = dict[str, Any]

# The width of a sheet over which its curve is said is twice this, mm.
HALF_WIDTH_MM: Final = 100.0
# The travel over which a stage's bow and turn are said, mm.
BOWED_OVER_MM: Final = 100.0
# A step of differences, rad.
_STEP_RAD: Final = 1e-6
# A variance that is smaller than this beside the largest is none.
_OPEN: Final = 1e-9


def light_summary(rig: Rig, covariance: Covariance | None, rays: Float[np.ndarray, "rays 3"]) -> list[Summary]:
    """For each light its parameters, its place, and the angles between it and the camera's view.

    The triangulation angle is that between a ray of the camera and the sheet.

    Args:
        rig: the rig.
        covariance: of its parameters, where it is known.
        rays: over the image, the middle one in the middle.
    """
    return [
        {
            "name": light.name,
            "kind": light.kind,
            **_numbers(f"lights.{i}", light, covariance),
            **_sheet(light, rays),
            **_of_light_kind(f"lights.{i}", light, covariance, rays),
        }
        for i, light in enumerate(rig.lights)
    ]


def axis_summary(rig: Rig, covariance: Covariance | None) -> list[Summary]:
    """For each axis, from the room to the object: its parameters, its direction in words, and what its kind adds."""
    # Things are scanned in the middle of the view.
    inverse = [float(light.inverse_depth(np.array([[0.0, 0.0, 1.0]]))[0]) for light in rig.lights]
    near = np.array([0.0, 0.0, max((1 / x for x in inverse if x > 0), default=0.0)])
    return [
        {
            "axis": part.axis,
            "kind": part.kind,
            **_numbers(f"motion.{part.axis}", part, covariance),
            "way": part.way(),
            **_of_kind(part, covariance, near),
        }
        for part in rig.motion.parts()
    ]


def _of_light_kind(
    stem: str, light: Light, covariance: Covariance | None, rays: Float[np.ndarray, "rays 3"]
) -> Summary:
    """How far a bowed sheet is off its plane at the ends of 200 mm, at the depth where it is seen in the middle.

    Of one that moves how far it does, and about which axis.
    """
    if isinstance(light, SweptSheet):
        degrees = light.amount(1000.0)[0]
        return {
            "axis": light.axis,
            "degrees_per_1000_steps": degrees,
            "about": light.direction().tolist(),
            "middle_steps": float(light.middle[0]),
        }
    w, _, _ = inverse_depths(light, rays[len(rays) // 2][None])
    if not isinstance(light, BowedSheet) or not w[0] > 0:
        return {}
    depth = float(1 / w[0])
    # Linear in the bow, whose σ that of the plane adds nothing to.
    sigma = covariance.sigma(f"{stem}.bow.0") if covariance else None
    return {
        "curved_mm": light.sag(HALF_WIDTH_MM, depth),
        "curved_mm_sigma": None if sigma is None else light.of_bow(HALF_WIDTH_MM, depth) * sigma,
    }


def _of_kind(part: AxisMotion, covariance: Covariance | None, near: Float[np.ndarray, "3"]) -> Summary:
    if isinstance(part, Rotary):
        return asdict(turn_summary(part, covariance, near)) | _of_play(part, covariance)
    if isinstance(part, Line):
        return {
            "mm_per_1000_steps": part.amount(1000.0)[0],
            "direction": part.direction().tolist(),
            **_of_path(part, covariance),
            **_of_play(part, covariance),
        }
    if isinstance(part, HeadPoses | ObjectPoses):
        return _of_poses(part, covariance)
    return {}


def _of_poses(part: HeadPoses | ObjectPoses, covariance: Covariance | None) -> Summary:
    """Where hand or base is as the camera sees it, with the largest σ of its turn and those of its place."""
    K = part.to_camera()
    turn = np.asarray(K.rotation, np.float64)
    angle = float(np.linalg.norm(turn))
    numbers = _numbers(f"motion.{part.axis}", part, covariance)
    known = [sigma for sigma in numbers["rotation"]["sigma"] or () if sigma is not None]
    return {
        "moves": next(moves for moves, kind in CARRIED_BY.items() if isinstance(part, kind)),
        "hand_mm": np.asarray(K.translation, np.float64).tolist(),
        "hand_sigma_mm": _sigma_of_place(part, covariance),
        "hand_open_along": _open_along(part, covariance),
        "turned_deg": math.degrees(angle),
        "turned_about": (turn / angle if angle else turn).tolist(),
        "turned_sigma_deg": math.degrees(max(known)) if known else None,
    }


def _sigma_of_place(part: HeadPoses | ObjectPoses, covariance: Covariance | None) -> list[float] | None:
    """σ of where hand or base is along the camera's axes, to first order, mm; None where it is not found."""
    names = [f"motion.{part.axis}.{number}.{i}" for number, count in part.numbers.items() for i in range(count)]
    if covariance is None or (S := covariance.among(names)) is None:
        return None
    w, offset = np.asarray(part.rotation, np.float64), np.asarray(part.offset, np.float64)
    by = _STEP_RAD * np.eye(3)
    of_turn = ((vector_to_matrix(w + by) - vector_to_matrix(w - by)) @ offset / (2 * _STEP_RAD)).T
    J = np.concatenate([of_turn, vector_to_matrix(w)], axis=1)
    return np.sqrt(np.diagonal(J @ S @ J.T)).tolist()


def _open_along(part: HeadPoses | ObjectPoses, covariance: Covariance | None) -> list[list[float]]:
    """Directions along which the offset is not found, in its axes: the covariance has nothing there."""
    if covariance is None or (S := covariance.among([f"motion.{part.axis}.offset.{i}" for i in range(3)])) is None:
        return []
    variances, ways = np.linalg.eigh(S)
    return ways[:, variances < _OPEN * variances[-1]].T.tolist()


def step_of(line: Line, covariance: Covariance) -> tuple[float, float]:
    """Length of one motor step along a line, and its σ, to first order, mm."""
    step = np.asarray(line.per_step, np.float64)
    S = covariance.among([f"motion.{line.axis}.per_step.{i}" for i in range(len(step))])
    assert S is not None, "the numbers of this line were held"
    length = float(np.linalg.norm(step))
    return length, float(np.sqrt(step @ S @ step)) / length


def _of_play(part: AxisMotion, covariance: Covariance | None) -> Summary:
    """How much farther on the load is when approached by falling steps than by rising ones."""
    if "play" not in part.numbers:
        return {}
    steps = float(part.play[0])  # type: ignore[attr-defined]
    sigma = covariance.sigma(f"motion.{part.axis}.play.0") if covariance else None
    amount, unit = part.amount(1.0)
    key = "play_mm" if unit == "mm" else "play_deg"
    return {key: steps * amount, f"{key}_sigma": None if sigma is None else sigma * amount}


def _of_path(part: Line, covariance: Covariance | None) -> Summary:
    """How far the middle of 100 mm of a bowed path is off the line through its ends, and how a screw is ahead."""
    summary: Summary = {}
    steps = BOWED_OVER_MM / part.amount(1.0)[0]
    for name, key, by in (
        ("bow", "bowed_mm", steps**2 / 4),
        ("turn", "turn_mrad", 1e3 * steps),
        ("wave", "wave_mm", 1.0),
    ):
        if name in part.numbers:
            summary |= _length(part, name, key, by, covariance)
    if isinstance(part, Screw | ScrewOnGuide):
        summary["period_steps"] = float(part.period[0])
        summary["period_steps_sigma"] = covariance.sigma(f"motion.{part.axis}.period.0") if covariance else None
    return summary


def _length(part: Line, name: str, key: str, by: float, covariance: Covariance | None) -> Summary:
    """The length of a part's vector times `by`, and its σ."""
    vector = np.array([float(leaf) for leaf in getattr(part, name)])
    length = float(np.linalg.norm(vector))
    names = [f"motion.{part.axis}.{name}.{i}" for i in range(len(vector))]
    sigma = None
    if covariance is not None and length > 0 and (S := covariance.among(names)) is not None:
        way = vector / length
        sigma = by * math.sqrt(max(float(way @ S @ way), 0.0))
    return {key: by * length, f"{key}_sigma": sigma}


def _numbers(stem: str, part: Light | AxisMotion, covariance: Covariance | None) -> Summary:
    return {
        name: {
            "value": [float(leaf) for leaf in getattr(part, name)],
            "sigma": [covariance.sigma(f"{stem}.{name}.{i}") for i in range(count)] if covariance else None,
        }
        for name, count in part.numbers.items()
    }


def _sheet(light: Light, rays: Float[np.ndarray, "rays 3"]) -> Summary:
    middle = len(rays) // 2
    w, _, _ = inverse_depths(light, rays)
    # NaN, outside the lens's range, compares as not seen.
    seen = w > 0
    with np.errstate(invalid="ignore", divide="ignore"):
        points = rays / w[:, None]
        normals = np.asarray(light.gradient(points), np.float64)
        sines = (normals * rays).sum(axis=1) / np.linalg.norm(normals, axis=1) / np.linalg.norm(rays, axis=1)
        angles = np.degrees(np.arcsin(sines))
    return {
        "distance_mm": float(abs(distance_from(light, np.zeros((1, 3)))[0])),
        "angle_to_axis_deg": math.degrees(math.asin(abs(sheet_axes(light)[2, 2]))),
        "depth_in_the_middle_mm": float(1 / w[middle]) if seen[middle] else None,
        "triangulation_angle_deg": float(angles[middle]) if seen[middle] else None,
        "triangulation_angles_deg": [float(angles[seen].min()), float(angles[seen].max())] if seen.any() else None,
    }


def format_path(summary: Summary) -> Iterator[str]:
    """How the path of an axis differs from a line or a turn, by its summary; nothing of one that does not."""

    def value(key: str, digits: str) -> str:
        sigma = summary[f"{key}_sigma"]
        return f"{summary[key]:{digits}}" + (f" ± {sigma:.2g}" if sigma is not None else "")

    if "bowed_mm" in summary:
        yield f"bowed by {value('bowed_mm', '.3g')} mm over 100 mm, turning by {value('turn_mrad', '.3g')} mrad"
    if "wave_mm" in summary:
        steps = value("period_steps", ".7g")
        yield f"ahead of its steps and behind by {value('wave_mm', '.3g')} mm, with a period of {steps} steps"
    for key, unit in (("play_mm", " mm"), ("play_deg", "°")):
        if key in summary:
            yield f"farther on by {value(key, '.3g')}{unit} where it is approached by falling steps, its play"
