"""The HTTP interface: everything that the pages can do, and they do it through this."""

from collections.abc import AsyncIterator, Generator
from functools import partial
from typing import Annotated, Any, Literal

from fastapi import APIRouter, Path, Request
from fastapi.responses import FileResponse, Response, StreamingResponse
from pydantic import BaseModel, ConfigDict, Field
from starlette.types import Receive, Scope, Send

from hardware.lab.accounts import Token
from hardware.lab.background import Workers
from hardware.lab.calibrations import Calibration
from hardware.lab.hub import Hub
from hardware.lab.lab import Lab, State
from hardware.lab.logbook import Job
from hardware.lab.measuring import Clicks, Found
from hardware.lab.orders import ProjectName, Work
from hardware.lab.projects import Project
from hardware.lab.refusal import CONFLICT, NOT_THERE, Refusal
from hardware.lab.rigs import CalibratedRig
from hardware.lab.web import Administrator, LabHere, Operator, Person, Viewer, known_visitor

_BOUNDARY = b"--picture\r\n"
_FARTHEST_ID = 2**63 - 1


class Detail(BaseModel):
    """Why a request was not granted."""

    detail: str


def _said(*statuses: int) -> dict[int | str, dict[str, Any]]:
    return {status: {"model": Detail} for status in statuses}


def _answers(response: type[Response], media: str, *statuses: int) -> dict[str, Any]:
    """What declares a route whose answer is no JSON: its class and type, and with which statuses it may refuse."""
    return {"response_class": response, "responses": {200: {"content": {media: {}}}, **_said(*statuses)}}


router = APIRouter(prefix="/api", responses=_said(401, 403, 413, 429))

ProjectPath = Annotated[ProjectName, Path()]
Number = Annotated[int, Path(ge=0, le=_FARTHEST_ID)]


class _Body(BaseModel):
    model_config = ConfigDict(extra="forbid", strict=True)


class Me(BaseModel):
    """Whoever asks. `seat` is what `operator.seat` of the state is compared with."""

    name: str
    administrator: bool
    seat: str


class Take(_Body):
    """How to take the scanner."""

    take_over: bool = Field(
        False, description="from whoever has it: for administrators, and from another seat of your own"
    )


class Live(_Body):
    """The live picture."""

    on: bool
    laser: bool = False


class Use(_Body):
    """Which rig to take into use."""

    name: str = Field(
        max_length=64,
        description='of the calibration session that it comes from; "" for that which the server was started with, '
        "or for none",
    )


class Stopped(BaseModel):
    """What a stop could not do; "" where all is well."""

    left_on: str


class NewToken(_Body):
    """A token to make."""

    name: Annotated[str, Field(min_length=1, max_length=64, description="what it is for")]


class MadeToken(BaseModel):
    """A token, seen this once."""

    token: str


@router.get("/me", tags=["account"])
def me(who: Viewer) -> Me:
    """Who you are."""
    return Me(name=who.name, administrator=who.administrator, seat=who.seat)


@router.get("/tokens", tags=["account"])
def tokens(lab: LabHere, who: Viewer) -> list[Token]:
    """Your tokens."""
    return lab.accounts.tokens(who.user)


@router.post("/tokens", status_code=201, tags=["account"])
def make_token(lab: LabHere, who: Person, body: NewToken) -> MadeToken:
    """Make a token for a program; it is shown this once. A token makes none."""
    return MadeToken(token=lab.accounts.make_token(who.user, body.name))


@router.delete("/tokens/{number}", status_code=204, tags=["account"], responses=_said(404))
def drop_token(lab: LabHere, who: Person, number: Number) -> None:
    """End one of your tokens."""
    lab.accounts.drop_token(who.user, number)


@router.get("/state", tags=["watch"])
def state(lab: LabHere, who: Viewer) -> State:
    """The scanner as it is now."""
    return lab.state()


@router.get(
    "/events",
    tags=["watch"],
    **_answers(StreamingResponse, "text/event-stream", 503),
)
async def events(lab: LabHere, who: Viewer, request: Request) -> StreamingResponse:
    """Server-sent events: `state`, `profile`, and `ping`, at which the operator renews its lease."""

    async def stream() -> AsyncIterator[bytes]:
        async for kind, number, data in _watched(lab, request, "state", "profile", "ping"):
            yield b"event: %s\nid: %d\ndata: %s\n\n" % (kind.encode(), number, data)

    lab.hub.admit(who.administrator or lab.lock.held_by(who))
    return StreamingResponse(stream(), media_type="text/event-stream")


@router.get(
    "/pictures",
    tags=["watch"],
    **_answers(StreamingResponse, "multipart/x-mixed-replace", 503),
)
async def pictures(lab: LabHere, who: Viewer, request: Request) -> StreamingResponse:
    """Every photograph as it is taken, as a stream of JPEGs that video players show."""

    async def stream() -> AsyncIterator[bytes]:
        yield _BOUNDARY
        async for kind, _, data in _watched(lab, request, "picture", "ping"):
            if kind == "picture":
                yield b"Content-Type: image/jpeg\r\nContent-Length: %d\r\n\r\n%s\r\n%s" % (len(data), data, _BOUNDARY)

    lab.hub.admit(who.administrator or lab.lock.held_by(who))
    return StreamingResponse(stream(), media_type="multipart/x-mixed-replace; boundary=picture")


async def _watched(lab: Lab, request: Request, *kinds: str) -> AsyncIterator[tuple[str, int, bytes]]:
    """What a watcher sees, for as long as its session or token is valid and it is there."""
    async for message in lab.hub.watch(*kinds):
        if message[0] == "ping" and (known_visitor(request, lab) is None or await request.is_disconnected()):
            return
        yield message


def _latest(hub: Hub, kind: str, media_type: str, request: Request) -> Response:
    number, data = hub.latest(kind)
    if not number:
        raise Refusal(NOT_THERE, "no photograph has been taken yet")
    tag = f'"{kind}-{number}"'
    headers = {"ETag": tag, "Cache-Control": "no-cache"}
    if request.headers.get("if-none-match") == tag:
        return Response(status_code=304, headers=headers)
    return Response(data, media_type=media_type, headers=headers)


@router.get(
    "/picture",
    tags=["watch"],
    response_class=Response,
    responses={200: {"content": {"image/jpeg": {}}}, 304: {}, **_said(404)},
)
def picture(lab: LabHere, who: Viewer, request: Request) -> Response:
    """The last photograph, as a JPEG for the screen; with an ETag."""
    return _latest(lab.hub, "picture", "image/jpeg", request)


@router.get("/profile", tags=["watch"], responses={304: {}, **_said(404)})
def profile(lab: LabHere, who: Viewer, request: Request) -> dict[str, Any]:
    """The stripe of the last photograph: `position` (px) for each `line`, and with a rig `points` (mm)."""
    return _latest(lab.hub, "profile", "application/json", request)  # pyright: ignore[reportReturnType]


@router.get(
    "/cloud",
    tags=["watch"],
    **_answers(Response, "application/octet-stream"),
)
def cloud(lab: LabHere, who: Viewer) -> Response:
    """The points of the last scan so far, thinned: float32 x, y, z, little endian, mm, object frame."""
    return Response(lab.gallery.cloud(), media_type="application/octet-stream")


@router.post("/lock", tags=["operate"], responses=_said(409))
def take_lock(lab: LabHere, who: Viewer, body: Take) -> State:
    """Take the scanner: from then on you operate it, and others watch."""
    if body.take_over:
        lab.lock.take_over(who)
    else:
        lab.lock.take(who)
    return lab.state()


@router.put("/lock", status_code=204, tags=["operate"])
def renew_lock(lab: LabHere, who: Operator) -> None:
    """Say that you are still there; within `lease_s`, or somebody else may take the scanner."""


@router.delete("/lock", status_code=204, tags=["operate"], responses=_said(409))
def release_lock(lab: LabHere, who: Viewer) -> None:
    """Leave the scanner to others."""
    lab.lock.release(who)


@router.post("/jobs", status_code=202, tags=["operate"], responses=_said(409))
def start_job(lab: LabHere, who: Operator, work: Work) -> Job:
    """Order a job: `check`, `home`, `move`, `shoot`, `scan` or `calibrate`."""
    return lab.worker.start(work, who)


@router.get("/jobs", tags=["watch"])
def jobs(lab: LabHere, who: Viewer) -> list[Job]:
    """The last hundred jobs, latest first."""
    return lab.logbook.latest()


@router.get("/jobs/{number}", tags=["watch"], responses=_said(404))
def job(lab: LabHere, who: Viewer, number: Number) -> Job:
    """One job."""
    return lab.logbook.one(number)


@router.post("/jobs/{number}/{action}", status_code=202, tags=["operate"], responses=_said(404, 409))
def change_job(
    lab: LabHere, who: Operator, number: Number, action: Literal["pause", "resume", "abort", "take", "enough"]
) -> Job:
    """Pause or abort a job under way; continue a scan that is paused or ended early.

    A calibration session: `take` the photograph, or begin the stage's sequence; `enough` views, or no stage.
    """
    worker = lab.worker
    act = {
        "pause": worker.pause,
        "resume": worker.resume,
        "abort": worker.abort,
        "take": partial(worker.answer, go=True),
        "enough": partial(worker.answer, go=False),
    }
    return act[action](number, who)


@router.post("/stop", tags=["operate"])
def stop(lab: LabHere, who: Viewer) -> Stopped:
    """Stand still and switch the laser off, at once; for the operator and for administrators.

    It comes before every other request, and waits for none.
    """
    return Stopped(left_on=lab.emergency.order(who).result())


@router.put("/live", status_code=204, tags=["operate"])
def live(lab: LabHere, who: Operator, body: Live) -> None:
    """Switch the live picture on or off; it goes off with its operator."""
    lab.preview.switch(body.on, body.laser)


@router.get("/projects", tags=["projects"])
async def projects(lab: LabHere, who: Viewer) -> list[Project]:
    """All projects, latest first."""
    return await lab.lists.run(who.name, lab.projects.all)


@router.get("/projects/{name}", tags=["projects"], responses=_said(404, 409))
async def project(lab: LabHere, who: Viewer, name: ProjectPath) -> Project:
    """One project."""
    return await lab.lists.run(who.name, lambda: lab.projects.one(name))


@router.get(
    "/projects/{name}/scan.zip",
    tags=["projects"],
    **_answers(StreamingResponse, "application/zip", 404, 409),
)
async def scan_zip(lab: LabHere, who: Viewer, name: ProjectPath) -> StreamingResponse:
    """The scan folder, as `jaxscan reconstruct` reads it once unpacked."""
    return _Zip(name, await lab.lists.run(who.name, lambda: lab.projects.archive(name)), lab.downloads, who.name)


@router.get(
    "/projects/{name}/cloud.ply",
    tags=["projects"],
    **_answers(FileResponse, "model/ply", 404, 409),
)
async def cloud_ply(lab: LabHere, who: Viewer, name: ProjectPath) -> FileResponse:
    """Its points, reconstructed with the rig that is loaded; that takes its time, one after the other."""
    path = await lab.lists.run(who.name, lambda: lab.projects.cloud_file(name))
    if not path.exists():
        path = await lab.clouds.run(who.name, lambda: lab.projects.cloud(name))
    return FileResponse(path, media_type="model/ply", filename=f"{name}.ply")


@router.get(
    "/projects/{name}/points",
    tags=["projects"],
    **_answers(FileResponse, "application/octet-stream", 404, 409),
)
async def points(lab: LabHere, who: Viewer, name: ProjectPath) -> FileResponse:
    """Some of its points, for a page to draw: float32 x, y, z, little endian, mm, object frame."""
    path = await lab.clouds.run(who.name, lambda: lab.projects.drawn(name))
    return FileResponse(path, media_type="application/octet-stream")


@router.post("/projects/{name}/measure", tags=["projects"], responses=_said(404, 409))
async def measure(lab: LabHere, who: Viewer, name: ProjectPath, body: Clicks) -> Found:
    """Measure faces that were clicked on its points: planes, balls, cylinders, cones, and what is between two."""
    return await lab.clouds.run(who.name, lambda: lab.projects.measured(name, body))


@router.get(
    "/projects/{name}/frames/{number}",
    tags=["projects"],
    **_answers(FileResponse, "image/png", 404, 409),
)
async def frame(lab: LabHere, who: Viewer, name: ProjectPath, number: Number) -> FileResponse:
    """One photograph, counted from 0."""
    path = await lab.lists.run(who.name, lambda: lab.projects.frame(name, number))
    return FileResponse(path, media_type="image/png")


@router.delete("/projects/{name}", status_code=204, tags=["projects"], responses=_said(404, 409))
def remove_project(lab: LabHere, who: Administrator, name: ProjectPath) -> None:
    """Remove a project, photographs and all."""
    if lab.worker.uses(project=name):
        raise Refusal(CONFLICT, f"a job adds photographs to {name}: end it first")
    lab.projects.remove(name)


@router.get("/calibrations", tags=["calibrations"])
async def calibrations(lab: LabHere, who: Viewer) -> list[Calibration]:
    """All calibration sessions, latest first."""
    return await lab.lists.run(who.name, lab.calibrations.all)


@router.get(
    "/calibrations/{name}/session.zip",
    tags=["calibrations"],
    **_answers(StreamingResponse, "application/zip", 404, 409),
)
async def session_zip(lab: LabHere, who: Viewer, name: ProjectPath) -> StreamingResponse:
    """The session folder, as `jaxscan calibrate` reads it once unpacked."""
    return _Zip(name, await lab.lists.run(who.name, lambda: lab.calibrations.archive(name)), lab.downloads, who.name)


@router.post("/calibrations/{name}/rig", tags=["calibrations"], responses=_said(404, 409, 503))
async def calibrate_session(lab: LabHere, who: Operator, name: ProjectPath) -> CalibratedRig:
    """Calibrate from a session: its rig, and how good it is. That takes a minute or two; then it can be used."""
    session = await lab.lists.run(who.name, lambda: lab.calibrations.session(name))
    if lab.worker.uses(session=name):
        raise Refusal(CONFLICT, f"a job adds photographs to {name}: end it first")
    return await lab.solves.run(who.name, lambda: lab.rigs.calibrate(name, session))


@router.get("/rigs", tags=["calibrations"])
async def rigs(lab: LabHere, who: Viewer) -> list[CalibratedRig]:
    """All rigs that can be taken into use, latest first."""
    return await lab.lists.run(who.name, lab.rigs.all)


@router.put("/rig", tags=["calibrations"], responses=_said(404, 409))
async def use_rig(lab: LabHere, who: Operator, body: Use) -> State:
    """Take a rig into use: points are made with it from now on, also by the next server."""
    if lab.worker.busy:
        raise Refusal(CONFLICT, "a job is under way, whose points are made with the rig: end it first")
    await lab.lists.run(who.name, lambda: lab.rigs.use(body.name))
    return lab.state()


@router.delete("/calibrations/{name}", status_code=204, tags=["calibrations"], responses=_said(404, 409))
def remove_calibration(lab: LabHere, who: Administrator, name: ProjectPath) -> None:
    """Remove a calibration session, photographs and all."""
    if lab.worker.uses(session=name):
        raise Refusal(CONFLICT, f"a job adds photographs to {name}: end it first")
    lab.calibrations.remove(name)


class _Zip(StreamingResponse):
    """A ZIP file as it is made, in a place among the downloads until it is sent or nobody reads it any more."""

    def __init__(self, name: str, parts: Generator[bytes, None, None], downloads: Workers, whose: str):
        self._leave = downloads.enter(whose)
        self._sent = downloads.each(parts)
        headers = {"Content-Disposition": f'attachment; filename="{name}.zip"'}
        super().__init__(self._sent, media_type="application/zip", headers=headers)

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        try:
            await super().__call__(scope, receive, send)
        finally:
            self._leave()
            await self._sent.aclose()
