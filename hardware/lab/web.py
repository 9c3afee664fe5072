"""What stands between a request and the lab: who asks, what is refused, and what every answer says to a browser.

A browser has a session cookie, and sends the session's CSRF token with whatever changes something; a program has a
bearer token, which no browser sends by itself.
"""

import logging
from hmac import compare_digest
from typing import Annotated, Final

from fastapi import Depends, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse, RedirectResponse, Response
from starlette.datastructures import MutableHeaders
from starlette.types import ASGIApp, Message, Receive, Scope, Send

from hardware.lab.badges import Visitor
from hardware.lab.lab import Lab
from hardware.lab.refusal import CONFLICT, FORBIDDEN, FULL, SIGN_IN, WRONG, WRONG_VALUE, Refusal

_LOG: Final = logging.getLogger(__name__)
LARGEST_BODY: Final = 1 << 16
CSRF_HEADER: Final = "X-CSRF-Token"
_AGAIN_S: Final = 2.0
_SAFE: Final = ("GET", "HEAD", "OPTIONS")
_HEADERS: Final = {
    "Content-Security-Policy": "default-src 'self'; img-src 'self' blob:; object-src 'none'; base-uri 'none'; "
    "form-action 'self'; frame-ancestors 'none'",
    "X-Content-Type-Options": "nosniff",
    "Referrer-Policy": "same-origin",
    "Cross-Origin-Opener-Policy": "same-origin",
    "Cross-Origin-Resource-Policy": "same-origin",
    "Cache-Control": "no-store",
}


class SignInFirst(Exception):  # noqa: N818 (the way to the sign-in page)
    """A page was asked for without a session."""


def lab_of(request: Request) -> Lab:
    """The lab that the application serves."""
    return request.app.state.lab


LabHere = Annotated[Lab, Depends(lab_of)]


def session_cookie(request: Request) -> str:
    """Name of the session's cookie: over TLS one that no other host, and no page without TLS, can set."""
    return "__Host-scanner" if request.url.scheme == "https" else "scanner"


def set_cookie(response: Response, request: Request, name: str, value: str, max_age: float | None = None) -> None:
    """Set a cookie that scripts cannot read and other sites do not send."""
    response.set_cookie(
        name,
        value,
        max_age=None if max_age is None else int(max_age),
        path="/",
        secure=request.url.scheme == "https",
        httponly=True,
        samesite="strict",
    )


def known_visitor(request: Request, lab: Lab) -> Visitor | None:
    """Who asks, as far as it is known in memory: this waits for nothing."""
    if (token := _token(request)) is not None:
        return lab.accounts.badges.of_token(token)
    return lab.accounts.badges.of_session(request.cookies.get(session_cookie(request), ""))


def must_mean_it(request: Request, who: Visitor) -> None:
    """See that a change by a browser comes from a page of this session.

    Raises:
        Refusal: it does not.
    """
    if (
        who.csrf is not None
        and request.method not in _SAFE
        and not same(request.headers.get(CSRF_HEADER, ""), who.csrf)
    ):
        raise Refusal(FORBIDDEN, f"a change by a browser needs the session's {CSRF_HEADER}: load the page again")


def _token(request: Request) -> str | None:
    """The bearer token; None where the request does not say who asks, and "" where it says it in another way."""
    authorization = request.headers.get("authorization")
    if authorization is None:
        return None
    kind, _, token = authorization.partition(" ")
    return token.strip() if kind.lower() == "bearer" else ""


def visitor(request: Request, lab: LabHere) -> Visitor:
    """Who asks; without a session or a token nobody gets further.

    Raises:
        Refusal: neither, or a change without the session's CSRF token.
    """
    if (token := _token(request)) is not None:
        found = lab.accounts.of_token(token)
        if found is None:
            raise Refusal(SIGN_IN, "the token is not valid: make one with scanner user token, or on the account page")
        return found
    found = lab.accounts.of_session(request.cookies.get(session_cookie(request), ""))
    if found is None:
        raise Refusal(SIGN_IN, "sign in first, or send a token: Authorization: Bearer …")
    must_mean_it(request, found)
    return found


def page_visitor(request: Request, lab: LabHere) -> Visitor:
    """Who asks for a page, by session alone.

    Raises:
        SignInFirst: nobody.
    """
    found = lab.accounts.of_session(request.cookies.get(session_cookie(request), ""))
    if found is None:
        raise SignInFirst
    return found


def page_reader(request: Request, lab: LabHere) -> Visitor:
    """Who asks for a page that programs read too: by token, or by session.

    Raises:
        Refusal: the token is not valid.
        SignInFirst: there is neither.
    """
    return visitor(request, lab) if "authorization" in request.headers else page_visitor(request, lab)


def operator(lab: LabHere, who: Annotated[Visitor, Depends(visitor)]) -> Visitor:
    """The holder of the operator's lock.

    Raises:
        Refusal: it is somebody else.
    """
    lab.lock.require(who)
    return who


def administrator(who: Annotated[Visitor, Depends(visitor)]) -> Visitor:
    """An administrator.

    Raises:
        Refusal: it is none.
    """
    if not who.administrator:
        raise Refusal(FORBIDDEN, "only an administrator may do this")
    return who


def person(who: Annotated[Visitor, Depends(visitor)]) -> Visitor:
    """Somebody who has signed in with a password: a token that was stolen lives no longer than itself.

    Raises:
        Refusal: it is a program.
    """
    if who.csrf is None:
        raise Refusal(FORBIDDEN, "a token neither makes nor ends tokens: use the account page, or scanner user token")
    return who


Viewer = Annotated[Visitor, Depends(visitor)]
Operator = Annotated[Visitor, Depends(operator)]
Administrator = Annotated[Visitor, Depends(administrator)]
Person = Annotated[Visitor, Depends(person)]
PageVisitor = Annotated[Visitor, Depends(page_visitor)]
PageReader = Annotated[Visitor, Depends(page_reader)]


def same(given: str, expected: str | None) -> bool:
    """Compare a secret in a time that does not reveal how much of it is right."""
    return expected is not None and compare_digest(given.encode("utf-8", "replace"), expected.encode())


def refused(request: Request, error: Exception) -> Response:
    """The answer to what is not granted."""
    assert isinstance(error, Refusal)
    headers = {} if error.retry_s is None else {"Retry-After": str(max(1, round(error.retry_s)))}
    if error.status == WRONG:
        # What follows on the connection may be read in two ways.
        headers["Connection"] = "close"
    if error.status == SIGN_IN:
        headers["WWW-Authenticate"] = "Bearer"
    return JSONResponse({"detail": str(error)}, error.status, headers)


def not_on_disk(request: Request, error: Exception) -> Response:
    """The answer where a file or folder of the lab is not what it was; its place stays in the server's log."""
    assert isinstance(error, OSError)
    _LOG.warning("%s %s: %s", request.method, request.url.path, error)
    words = f"the lab's disk: {error.strerror or error}: somebody has to look after it on the lab's machine"
    return JSONResponse({"detail": words}, CONFLICT)


def not_in_database(request: Request, error: Exception) -> Response:
    """The answer where the database cannot be written or read now: full, locked, or on a disk that fails."""
    _LOG.warning("%s %s: %s", request.method, request.url.path, error)
    words = f"the lab's database: {error}: try again, and somebody has to look after it on the lab's machine"
    return refused(request, Refusal(FULL, words, _AGAIN_S))


def gone(request: Request, error: Exception) -> Response:
    """The answer to somebody who went before the request was whole, which nobody reads."""
    return Response(status_code=400)


def to_sign_in(request: Request, error: Exception) -> Response:
    """The answer to a page without a session."""
    return RedirectResponse("/sign-in", 303)


def not_understood(request: Request, error: Exception) -> Response:
    """The answer to values that are none: which, and why; not what they were, which may be no JSON."""
    assert isinstance(error, RequestValidationError)
    kept = ("loc", "msg", "type")
    return JSONResponse({"detail": [{key: one[key] for key in kept} for one in error.errors()]}, WRONG_VALUE)


class Headers:
    """Adds what every answer says to the browser."""

    def __init__(self, app: ASGIApp):
        self._app = app

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""

        async def send_with_headers(message: Message) -> None:
            if message["type"] == "http.response.start":
                headers = MutableHeaders(scope=message)
                for name, value in _HEADERS.items():
                    headers.setdefault(name, value)
            await send(message)

        await self._app(scope, receive, send_with_headers)
