"""What an operator may order: the work of a job, as a request brings it and as the logbook keeps it."""

from collections.abc import Mapping
from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

from hardware.places import STAGE, TURNTABLE, Place, along, full_turn
from hardware.stages import Travel

# A name is a folder too: nothing in it leads anywhere else.
PROJECT = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"
_FARTHEST = 10**9
_MOST_FRAMES = 10_000
_MOST_CORNERS = 100

_MOST_AXES = 16

ProjectName = Annotated[str, Field(pattern=PROJECT, description="letters, digits, _ and -", examples=["cup"])]
Step = Annotated[int, Field(ge=-_FARTHEST, le=_FARTHEST, description="motor steps", examples=[2000])]
AxisName = Annotated[
    str, Field(pattern=r"^[A-Za-z0-9_-]{1,64}$", description="one of `axes` of the state", examples=["stage"])
]
At = Annotated[
    dict[AxisName, Step], Field(max_length=_MOST_AXES, description="where other axes stand, motor steps by their names")
]


class _Work(BaseModel):
    # A number is a number: "1" and true, and 1.0 for a step, come from a program that is wrong.
    model_config = ConfigDict(extra="forbid", frozen=True, strict=True)


class Check(_Work):
    """See whether axes and camera answer: one photograph, no move."""

    kind: Literal["check"] = "check"


class Home(_Work):
    """Reset the motors: connect again if need be, drive to the reference switch, and from there to step 0."""

    kind: Literal["home"] = "home"
    axis: AxisName | None = Field(None, description="this one alone; without it all of them, one after the other")


class Move(_Work):
    """Go to a place."""

    kind: Literal["move"] = "move"
    axis: AxisName = "stage"
    step: Step


class Shoot(_Work):
    """Step and shoot: go to a place and add a photograph of it to a project, numbered in sequence."""

    kind: Literal["shoot"] = "shoot"
    project: ProjectName
    axis: AxisName = "stage"
    step: Step
    at: At = {}
    settle_s: float = Field(0.2, ge=0, le=60, description="wait before the photograph, s")


class Scan(_Work):
    """Batch mode: a number of photographs along an axis, or around it, added to a project."""

    kind: Literal["scan"] = "scan"
    project: ProjectName
    axis: AxisName = "stage"
    at: At = {}
    first: Step = 0
    apart: Step | None = Field(
        None, description="motor steps from one to the next; without it a full turn of the axis, in equal parts"
    )
    frames: int = Field(ge=1, le=_MOST_FRAMES)
    settle_s: float = Field(0.2, ge=0, le=60, description="wait before each photograph, s")
    dark: bool = Field(False, description="with each photograph one with the laser off")
    verify: int | None = Field(
        0,
        ge=0,
        description="after how many photographs axes that can meet their switches again, to see whether steps were "
        "lost; 0 for at the end alone, null for never",
    )


class Calibrate(_Work):
    """A guided calibration session: the state's `guide` says what to do with the board, and `take` that it is done."""

    kind: Literal["calibrate"] = "calibrate"
    session: ProjectName
    columns: int = Field(9, ge=3, le=_MOST_CORNERS, description="inner corners of the checkerboard in a row")
    rows: int = Field(6, ge=3, le=_MOST_CORNERS, description="and in a column")
    square_mm: float = Field(16.0, ge=0.01, le=1000, description="side of its squares, mm")
    views: int = Field(11, ge=3, le=1000, description="poses of the board")
    stage_frames: int = Field(31, ge=0, le=_MOST_FRAMES, description="places of the stage; 0 for a rig without one")
    stage_apart: Step = 2000
    turntable_frames: int = Field(0, ge=0, le=_MOST_FRAMES, description="places of the turntable, once around")
    turntable_at: Step = Field(0, description="where the stage stands meanwhile, motor steps")

    @property
    def steps(self) -> tuple[int, ...]:
        """Where the board is photographed on the stage."""
        return tuple(self.stage_apart * i for i in range(self.stage_frames))


def turns_of(work: Calibrate, travels: Mapping[str, Travel]) -> tuple[int, ...]:
    """Where the board is photographed on the turntable.

    Raises:
        SettingsError: the scanner has none, or it is not known how many steps a turn has.
    """
    return full_turn(travels, TURNTABLE, work.turntable_frames) if work.turntable_frames else ()


def places_of_work(work: "Work", travels: Mapping[str, Travel]) -> tuple[Place, ...]:
    """Where a job sends the axes, photograph by photograph.

    Raises:
        SettingsError: a full turn was asked for, of an axis of which it is not known how many steps that is.
    """
    if isinstance(work, Calibrate):
        at = {STAGE: work.turntable_at} if STAGE in travels else {}
        return (*along(STAGE, work.steps), *along(TURNTABLE, turns_of(work, travels), at))
    if isinstance(work, Move):
        return along(work.axis, (work.step,))
    if isinstance(work, Shoot):
        return along(work.axis, (work.step,), work.at)
    if isinstance(work, Scan):
        if work.apart is None:
            return along(work.axis, full_turn(travels, work.axis, work.frames, work.first), work.at)
        return along(work.axis, [work.first + work.apart * i for i in range(work.frames)], work.at)
    return ()


Work = Annotated[Check | Home | Move | Shoot | Scan | Calibrate, Field(discriminator="kind")]
WORK: TypeAdapter[Check | Home | Move | Shoot | Scan | Calibrate] = TypeAdapter(Work)
