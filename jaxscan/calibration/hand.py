"""The pose of a hand in the camera's frame, as a calibration has it; and what a solve holds before it is known."""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float

from jaxscan.axis_details import POSES
from jaxscan.calibration.observations import Observations
from jaxscan.errors import InputError
from jaxscan.rig import CARRIED_BY, AxisMotion, PoseRange

# Given poses that show how camera and hand stand.
FEWEST_POSES = 3
# With fewer, σ of poses is itself known badly.
_FEW_POSES = 8
# Lengths of poses and photographs are said to differ where they do by more than this share, and this multiple of σ.
_SCALE, _SCALE_SIGMAS = 0.002, 4.0
# By this share no arm is wrong: one of the two scales is.
_WRONG_SCALE = 0.005
# Poses that are left out and named.
_NAMED = 3
# A given σ is called too small where the poses scatter by more than this multiple of it.
_CLEARLY_MORE = 1.5


@dataclass(frozen=True)
class Hand:
    """How well given poses go with the photographs, by which the pose of hand or base in the camera's frame is found.

    Attributes:
        moves: "head" or "object".
        names: of the photographs.
        kept: which of them took part.
        off_mm: by how much each given position is off, along the base's axes.
        off_deg: by how much each given rotation is off, about the hand's axes.
        sigma_mm: σ of a given position along each axis, as it was taken.
        sigma_deg: σ of a given rotation about each axis, as it was taken.
        found_mm: that σ as the photographs show it.
        found_deg: that σ as the photographs show it.
        unknown: directions along which the offset is not found, because no pose turned about another: in the axes of
            the hand (a head) or the base (an object).
        board_mm: how far the board's middle was from the hand, in the median.
        given: the two σ as they were given, mm and degrees; None for one that was not.
        scale: the lengths of the given positions over those that the photographs show.
        scale_sigma: its σ.
        range: of the given poses that took part.
    """

    moves: str
    names: tuple[str, ...]
    kept: Bool[np.ndarray, "photographs"]
    off_mm: Float[np.ndarray, "photographs 3"]
    off_deg: Float[np.ndarray, "photographs 3"]
    sigma_mm: float
    sigma_deg: float
    found_mm: float
    found_deg: float
    unknown: Float[np.ndarray, "directions 3"]
    board_mm: float
    given: tuple[float | None, float | None]
    scale: float
    scale_sigma: float
    range: PoseRange

    @property
    def profile_mm(self) -> float:
        """By how much a profile is off along each axis by its pose alone, at the board's distance from the hand, mm."""
        return float(np.hypot(self.sigma_mm, np.radians(self.sigma_deg) * self.board_mm))

    @property
    def how_far_off(self) -> tuple[Float[np.ndarray, "photographs"], Float[np.ndarray, "photographs"]]:
        """By how much each given pose is off, mm and degrees."""
        return np.linalg.norm(self.off_mm, axis=1), np.linalg.norm(self.off_deg, axis=1)

    def facts(self) -> dict[str, object]:
        """What a rig file has of it."""
        return {
            "pose_images": len(self.names),
            "pose_sigma_mm": self.sigma_mm,
            "pose_sigma_deg": self.sigma_deg,
            "pose_range": self.range.values(),
            **({"pose_offset_unknown": self.unknown.tolist()} if len(self.unknown) else {}),
        }

    def note(self) -> str:
        """How well the poses go with the photographs, in words."""
        return (
            f"the given poses of {int(self.kept.sum())} photographs scatter by {self.found_mm:.2g} mm and "
            f"{self.found_deg:.2g}° about each axis: at the board's distance from the hand, {self.board_mm:.0f} mm, "
            f"that moves every profile of a scan by {self.profile_mm:.2g} mm of its own"
            + (f"; with fewer than {_FEW_POSES} poses this is poorly known, so σ may be too small" if self._few else "")
        )

    @property
    def _few(self) -> bool:
        return int(self.kept.sum()) < _FEW_POSES and None in self.given

    def rejected(self) -> list[str]:
        """The poses that were left out, in words."""
        mm, degrees = self.how_far_off
        return [
            f"{self.names[i]}: its given pose is {mm[i]:.3g} mm and {degrees[i]:.2g}° off, and is not used"
            for i in np.flatnonzero(~self.kept)
        ]

    @property
    def statements(self) -> tuple[tuple[str, str], ...]:
        """What is wrong with the poses, and what to do; the first parts without their full stops."""
        said = [
            (
                f"The given poses scatter by {found:.2g}{unit}, more than {key} = {given:g}: the larger number is used",
                "Photograph where the robot stands still, and see that board and camera are mounted firmly.",
            )
            for given, found, unit, key in (
                (self.given[0], self.found_mm, " mm", "sigma_mm"),
                (self.given[1], self.found_deg, "°", "sigma_deg"),
            )
            if given is not None and found > _CLEARLY_MORE * given
        ]
        said += self.scale_statement
        if left_out := self.rejected():
            more = f", and {len(left_out) - _NAMED} more are not used" if len(left_out) > _NAMED else ""
            fix = "Check its line in the table of poses, and that the photograph was taken where the robot stood still."
            if len(left_out) > 1:
                fix = f"{fix} Where two were exchanged, both are named."
            said.append(("; ".join(left_out[:_NAMED]) + more, fix))
        return tuple(said)

    @property
    def scale_statement(self) -> tuple[tuple[str, str], ...]:
        """That the poses' lengths are not those of the photographs, and what to do; empty where they are."""
        if abs(self.scale - 1) <= max(_SCALE, _SCALE_SIGMAS * self.scale_sigma):
            return ()
        return (
            (
                f"The given positions are {self.scale:.4g} ± {self.scale_sigma:.1g} times as far apart as the "
                "photographs show",
                "Measure the board's squares and correct square_mm, which gives the photographs their scale; or "
                "see that the robot's positions are right.",
            ),
        )

    @property
    def wrong_scale(self) -> bool:
        """Whether one of the two scales is wrong, and with it where the hand is, by much more than its σ."""
        return bool(self.scale_statement) and abs(self.scale - 1) > _WRONG_SCALE

    def unknown_note(self) -> list[str]:
        """What the poses leave open, in words."""
        if not len(self.unknown):
            return []
        if len(self.unknown) == 3:
            return [
                "no pose turned, so only how the hand is turned to the camera is found, and not where it is: scans "
                "must be taken without turning too"
            ]
        axes = ", ".join("(" + ", ".join(f"{x:.2f}" for x in way) + ")" for way in self.unknown)
        return [
            f"no pose turned about another direction than {axes} of the {'hand' if self.moves == 'head' else 'base'}, "
            "so the place of the hand along it is not found: turn only about it in scans too, or photograph the board "
            "with the hand turned in two directions"
        ]


def moves_by_poses(observations: Observations) -> tuple[AxisMotion, ...]:
    """The motion of given poses before it is known; none where there are none."""
    if observations.hand is None or all(view.given is None for view in observations.views):
        return ()
    return (CARRIED_BY[observations.hand.moves].at_rest(POSES),)


def check_enough_poses(observations: Observations) -> None:
    """Refuse given poses that are too few.

    Raises:
        InputError: there are.
    """
    count = sum(view.given is not None for view in observations.views)
    if observations.hand is not None and count < FEWEST_POSES:
        raise InputError(
            f"{count} usable photographs at given poses; at least {FEWEST_POSES} are needed, 10 to 20 are good: take "
            "more, with all of the board in view"
        )
