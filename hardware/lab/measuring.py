"""What is measured of a project where its points are clicked: what a page asks, and what it is told."""

from typing import Annotated, Literal

from pydantic import BaseModel, ConfigDict, Field

_MOST_FACES = 24
_FARTHEST_MM = 1e6

Millimetres = Annotated[float, Field(ge=-_FARTHEST_MM, le=_FARTHEST_MM)]


class ClickedFace(BaseModel):
    """A click on a face."""

    model_config = ConfigDict(extra="forbid")

    kind: Literal["plane", "ball", "cylinder", "cone"] = "plane"
    place: Annotated[list[Millimetres], Field(min_length=3, max_length=3, description="x, y, z, object frame, mm")]
    radius: Annotated[float, Field(gt=0, le=_FARTHEST_MM, description="within which points are looked at, mm")]
    grow: bool = Field(False, description="whether the face goes on beyond the radius")
    measured_from: int | None = Field(
        None, ge=0, lt=_MOST_FACES, description="the number of the face, from 0, to which distance and angle are taken"
    )


class Clicks(BaseModel):
    """All faces, in the order in which they were clicked."""

    model_config = ConfigDict(extra="forbid")

    faces: Annotated[list[ClickedFace], Field(max_length=_MOST_FACES)]


class Face(BaseModel):
    """A face as it was found. `points` are some of its points, mm; `problem` says why there is none."""

    name: str
    points: list[tuple[float, float, float]]
    count: int
    left_out: int
    problem: str


class FoundDimension(BaseModel):
    """A dimension: mm or degrees; `uncertainty` is half of the interval that holds the true value with 95 %."""

    name: str
    value: float | None
    uncertainty: float | None
    unit: str
    words: str


class Found(BaseModel):
    """Faces and dimensions, and the text of a `part.toml` that measures them again in other scans."""

    faces: list[Face]
    dimensions: list[FoundDimension]
    notes: list[str]
    part: str
