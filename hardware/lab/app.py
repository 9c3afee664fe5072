"""The application: the lab's interface and pages as one ASGI application."""

import asyncio
import sqlite3
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress
from importlib.metadata import version
from pathlib import Path
from typing import Any, Final

from fastapi import FastAPI
from fastapi.exceptions import RequestValidationError
from fastapi.staticfiles import StaticFiles
from starlette.requests import ClientDisconnect

from hardware.lab import api, pages
from hardware.lab.front import Front
from hardware.lab.lab import Lab
from hardware.lab.refusal import Refusal
from hardware.lab.web import (
    LARGEST_BODY,
    Headers,
    SignInFirst,
    gone,
    not_in_database,
    not_on_disk,
    not_understood,
    refused,
    to_sign_in,
)

_HERE: Final = Path(__file__).parent
_DESCRIPTION: Final = """
One scanner, one operator at a time; everybody else watches. Take the lock (`POST /api/lock`), renew it within its
lease (`PUT /api/lock`), order jobs (`POST /api/jobs`), watch (`GET /api/events`), and let go (`DELETE /api/lock`).
Send a token with every request: `Authorization: Bearer …`; `scanner user token NAME` and the account page make one.
"""


def make_app(lab: Lab, names: frozenset[str] = frozenset()) -> FastAPI:
    """The application for one lab, known to browsers by these names and all addresses."""

    @asynccontextmanager
    async def lifespan(app: FastAPI) -> AsyncIterator[None]:
        lab.hub.open()
        telling = asyncio.create_task(lab.tell())
        try:
            yield
        finally:
            telling.cancel()
            with suppress(asyncio.CancelledError):
                await telling

    # What FastAPI would show of itself comes from another server, and for everybody.
    app = FastAPI(
        title="scanner lab",
        version=version("jaxscan"),
        description=_DESCRIPTION,
        lifespan=lifespan,
        openapi_url=None,
        docs_url=None,
        redoc_url=None,
        max_body_size=LARGEST_BODY,
    )
    app.state.lab = lab
    app.include_router(api.router)
    app.include_router(pages.router)
    app.mount("/static", StaticFiles(directory=_HERE / "static"), name="static")
    app.add_exception_handler(Refusal, refused)
    app.add_exception_handler(RequestValidationError, not_understood)
    app.add_exception_handler(SignInFirst, to_sign_in)
    app.add_exception_handler(OSError, not_on_disk)
    app.add_exception_handler(sqlite3.Error, not_in_database)
    app.add_exception_handler(ClientDisconnect, gone)
    app.add_middleware(Front, lab=lab, names=names)
    app.add_middleware(Headers)
    _describe_tokens(app)
    return app


def _describe_tokens(app: FastAPI) -> None:
    """Say in the interface's description how a program signs in."""
    make = app.openapi

    def described() -> dict[str, Any]:
        schema = make()
        schema["components"]["securitySchemes"] = {"token": {"type": "http", "scheme": "bearer"}}
        schema["security"] = [{"token": []}]
        return schema

    app.openapi = described  # pyright: ignore[reportAttributeAccessIssue]
