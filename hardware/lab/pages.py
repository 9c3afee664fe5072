"""The pages: sign-in, scanner, projects, account, and a description of the interface. They need no other server."""

import hashlib
import re
import secrets
from pathlib import Path
from typing import Any, Final
from urllib.parse import parse_qs

from fastapi import APIRouter, Request
from fastapi.concurrency import run_in_threadpool
from fastapi.responses import HTMLResponse, JSONResponse, RedirectResponse, Response
from fastapi.templating import Jinja2Templates
from markupsafe import Markup, escape

from hardware.lab.accounts import SHORTEST_PASSWORD
from hardware.lab.api import ProjectPath
from hardware.lab.badges import LONGEST_S, Visitor
from hardware.lab.interface import bodies
from hardware.lab.refusal import CONFLICT, FORBIDDEN, Refusal
from hardware.lab.throttle import network_of
from hardware.lab.web import LabHere, PageReader, PageVisitor, Viewer, same, session_cookie, set_cookie

router = APIRouter(include_in_schema=False)

_TEMPLATES: Final = Jinja2Templates(Path(__file__).parent / "templates")
# Descriptions mark code as Markdown does.
_TEMPLATES.env.filters["code"] = lambda words: Markup(re.sub(r"`([^`]+)`", r"<code>\1</code>", str(escape(words))))
# What the sign-in form has to bring back; without a session there is no other CSRF token.
_FORM_COOKIE: Final = "scanner_form"
_MOST_FIELDS: Final = 10
# How long a browser is known.
_KNOWN_S: Final = 365 * 86400.0


def _page(request: Request, template: str, who: Visitor | None, status: int = 200, **values: Any) -> HTMLResponse:
    return _TEMPLATES.TemplateResponse(request, f"{template}.html", {"who": who, "page": template, **values}, status)


async def _fields(request: Request) -> dict[str, str]:
    """The fields of a form.

    Raises:
        Refusal: it is none.
    """
    try:
        fields = parse_qs((await request.body()).decode(), keep_blank_values=True, max_num_fields=_MOST_FIELDS)
    except ValueError as error:
        raise Refusal(CONFLICT, "the form cannot be read: load the page again") from error
    return {name: values[0] for name, values in fields.items()}


def _browser_cookie(request: Request, name: str) -> str:
    """Name of the cookie that says that this account has signed in with this browser."""
    return (
        f"{session_cookie(request)}_known_{hashlib.sha256(name.casefold().encode('utf-8', 'replace')).hexdigest()[:12]}"
    )


@router.get("/sign-in")
def sign_in_page(request: Request) -> HTMLResponse:
    """The sign-in form."""
    return _sign_in_form(request)


def _sign_in_form(request: Request, refusal: Refusal | None = None, name: str = "") -> HTMLResponse:
    form = secrets.token_urlsafe(16)
    status, words = (refusal.status, str(refusal)) if refusal else (200, "")
    page = _page(request, "sign_in", None, status, form=form, words=words, name=name)
    if refusal is not None and refusal.retry_s is not None:
        page.headers["Retry-After"] = str(max(1, round(refusal.retry_s)))
    set_cookie(page, request, _FORM_COOKIE, form)
    return page


@router.post("/sign-in")
async def sign_in(request: Request, lab: LabHere) -> Response:
    """Sign in; whatever session was there before ends, and the new one has a name of its own."""
    fields = await _fields(request)
    name = fields.get("name", "")
    if not same(fields.get("form", ""), request.cookies.get(_FORM_COOKIE)):
        return _sign_in_form(request, Refusal(FORBIDDEN, "this form has expired: try again"), name)
    address = request.client.host if request.client else ""
    browser = _browser_cookie(request, name)

    def look() -> tuple[str, str]:
        session = lab.accounts.sign_in(name, fields.get("password", ""), address, request.cookies.get(browser, ""))
        return session, lab.accounts.know_browser(name)

    try:
        token, known = await lab.sign_ins.run(network_of(address), look)
    except Refusal as refusal:
        return _sign_in_form(request, refusal, name)
    await run_in_threadpool(lab.accounts.sign_out, request.cookies.get(session_cookie(request), ""))
    answer = RedirectResponse("/", 303)
    set_cookie(answer, request, session_cookie(request), token, LONGEST_S)
    set_cookie(answer, request, browser, known, _KNOWN_S)
    answer.delete_cookie(_FORM_COOKIE)
    return answer


@router.post("/sign-out")
async def sign_out(request: Request, lab: LabHere, who: PageVisitor) -> Response:
    """Sign out, and leave the scanner; a scan goes on."""
    fields = await _fields(request)
    if not same(fields.get("csrf", ""), who.csrf):
        raise Refusal(FORBIDDEN, "this form has expired: load the page again")

    def leave() -> None:
        lab.accounts.sign_out(request.cookies.get(session_cookie(request), ""))
        try:
            lab.lock.release(who)
        except Refusal:
            # A scan is running: it keeps the lock until it is done.
            return

    await run_in_threadpool(leave)
    answer = RedirectResponse("/sign-in", 303)
    answer.delete_cookie(session_cookie(request))
    return answer


@router.get("/")
def scanner_page(request: Request, lab: LabHere, who: PageVisitor) -> HTMLResponse:
    """The scanner."""
    return _page(request, "scanner", who, state=lab.state())


@router.get("/projects")
async def projects_page(request: Request, lab: LabHere, who: PageVisitor) -> HTMLResponse:
    """The projects."""
    projects, calibrations = await lab.lists.run(who.name, lambda: (lab.projects.all(), lab.calibrations.all()))
    return _page(request, "projects", who, projects=projects, calibrations=calibrations, rig=lab.state().rig)


@router.get("/projects/{name}/measure")
async def measure_page(request: Request, lab: LabHere, who: PageVisitor, name: ProjectPath) -> HTMLResponse:
    """Points of a project, to be measured by clicks."""
    project = await lab.lists.run(who.name, lambda: lab.projects.one(name))
    return _page(request, "measure", who, project=project, rig=lab.state().rig)


@router.get("/account")
def account_page(request: Request, lab: LabHere, who: PageVisitor) -> HTMLResponse:
    """Tokens."""
    return _page(request, "account", who, tokens=lab.accounts.tokens(who.user), shortest=SHORTEST_PASSWORD)


@router.get("/api")
def interface_page(request: Request, who: PageReader) -> HTMLResponse:
    """The HTTP interface, in words; to a program without the links and forms of a session."""
    schema = request.app.openapi()
    schemas = schema["components"]["schemas"]
    operations = [
        {"path": path, "method": method.upper(), "bodies": bodies(operation, schemas), **operation}
        for path, methods in schema["paths"].items()
        for method, operation in methods.items()
    ]
    of_session = None if who.csrf is None else who
    return _page(request, "interface", of_session, description=schema["info"]["description"], operations=operations)


@router.get("/api/openapi.json")
def openapi(request: Request, who: Viewer) -> JSONResponse:
    """The HTTP interface, for programs."""
    return JSONResponse(request.app.openapi())
