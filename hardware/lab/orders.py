"""What an operator may order: the work of a job, as a request brings it and as the logbook keeps it."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

# A name is a folder too: nothing in it leads anywhere else.
PROJECT = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"
_FARTHEST = 10**9
_MOST_FRAMES = 10_000
_MOST_CORNERS = 100

ProjectName = Annotated[str, Field(pattern=PROJECT, description="letters, digits, _ and -", examples=["cup"])]
Step = Annotated[int, Field(ge=-_FARTHEST, le=_FARTHEST, description="motor steps", examples=[2000])]


class _Work(BaseModel):
    model_config = ConfigDict(extra="forbid", frozen=True)


class Check(_Work):
    """See whether stage and camera answer: one photograph, no move."""

    kind: Literal["check"] = "check"


class Home(_Work):
    """Reset the motor: connect again if need be, drive to the reference switch, and from there to step 0."""

    kind: Literal["home"] = "home"


class Move(_Work):
    """Go to a place."""

    kind: Literal["move"] = "move"
    step: Step


class Shoot(_Work):
    """Step and shoot: go to a place and add a photograph of it to a project, numbered in sequence."""

    kind: Literal["shoot"] = "shoot"
    project: ProjectName
    step: Step
    settle_s: float = Field(0.2, ge=0, le=60, description="wait before the photograph, s")


class Scan(_Work):
    """Batch mode: so many photographs, so many steps apart, added to a project."""

    kind: Literal["scan"] = "scan"
    project: ProjectName
    first: Step = 0
    apart: Step
    frames: int = Field(ge=1, le=_MOST_FRAMES)
    settle_s: float = Field(0.2, ge=0, le=60, description="wait before each photograph, s")
    dark: bool = Field(False, description="with each photograph one with the laser off")

    @property
    def steps(self) -> tuple[int, ...]:
        """Where each is taken."""
        return tuple(self.first + self.apart * i for i in range(self.frames))


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

    @property
    def steps(self) -> tuple[int, ...]:
        """Where the board is photographed on the stage."""
        return tuple(self.stage_apart * i for i in range(self.stage_frames))


Work = Annotated[Check | Home | Move | Shoot | Scan | Calibrate, Field(discriminator="kind")]
WORK: TypeAdapter[Check | Home | Move | Shoot | Scan | Calibrate] = TypeAdapter(Work)
