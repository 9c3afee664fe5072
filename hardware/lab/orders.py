"""What an operator may order: the work of a job, as a request brings it and as the logbook keeps it."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field, TypeAdapter

# A name is a folder too: nothing in it leads anywhere else.
PROJECT = r"^[A-Za-z0-9][A-Za-z0-9_-]{0,63}$"
_FARTHEST = 10**9
_MOST_FRAMES = 10_000

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


Work = Annotated[Check | Home | Move | Shoot | Scan, Field(discriminator="kind")]
WORK: TypeAdapter[Check | Home | Move | Shoot | Scan] = TypeAdapter(Work)
