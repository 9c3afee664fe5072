"""What comes before everything else: Stop and the operator's renewal, in the thread that reads requests.

Both know in memory who asks, and wait for nothing that another request can hold; the rest of the interface is behind
them, and behind limits of how much one may ask for.
"""

import asyncio
import contextlib
import ipaddress
import re
import socket
from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from hardware.lab.badges import Visitor
from hardware.lab.lab import Lab
from hardware.lab.limits import ACCOUNT, STRANGER, Limits
from hardware.lab.refusal import MISDIRECTED, WRONG, Refusal
from hardware.lab.throttle import network_of
from hardware.lab.web import known_visitor, must_mean_it, refused

_STOP: Final = ("POST", "/api/stop")
_RENEW: Final = ("PUT", "/api/lock")
# What stays open, and has limits of its own.
_STAYS: Final = re.compile(r"/api/(events|pictures|(projects|calibrations)/[^/]+/(scan|session)\.zip)")
_HOST: Final = re.compile(r"(\[[0-9a-fA-F:.]+\]|[^:\[\]]+)(:\d{1,5})?")


def own_names(names: tuple[str, ...] = ()) -> frozenset[str]:
    """Names by which this machine is known, and those that were given."""
    own = {"localhost", socket.gethostname(), *names}
    return frozenset(name.casefold().rstrip(".") for name in own)


class Front:
    """Answers what cannot wait, refuses what is too much, and passes on the rest.

    Args:
        app: for the rest.
        lab: whose.
        names: in a Host header; addresses need none. Another site's name that leads here (DNS rebinding) is refused.
    """

    def __init__(self, app: ASGIApp, lab: Lab, names: frozenset[str]):
        self._app, self._lab, self._names = app, lab, names or own_names()
        self._limits = Limits()

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        with contextlib.ExitStack() as counted:
            answer = None
            try:
                self._check(request)
                who = known_visitor(request, self._lab)
                # Whoever is not known here may be by now, and is looked for where that may take time.
                if who is not None and (scope["method"], scope["path"]) in (_STOP, _RENEW):
                    answer = await self._at_once(request, who)
                else:
                    counted.enter_context(self._count(request, who))
            except Refusal as refusal:
                answer = refused(request, refusal)
            await (answer or self._app)(scope, receive, send)

    def _check(self, request: Request) -> None:
        """See that a request can be meant for this server, and in one way only.

        Raises:
            Refusal: it cannot.
        """
        if "content-length" in request.headers and "transfer-encoding" in request.headers:
            raise Refusal(WRONG, "a request has Content-Length or Transfer-Encoding, not both")
        hosts = request.headers.getlist("host")
        found = _HOST.fullmatch(hosts[0]) if len(hosts) == 1 else None
        if found is None or not self._own(found[1].strip("[]").casefold().rstrip(".")):
            raise Refusal(
                MISDIRECTED, "this server is not known by that name: use its address, or start it with --name NAME"
            )

    def _own(self, host: str) -> bool:
        if host in self._names:
            return True
        try:
            ipaddress.ip_address(host)
        except ValueError:
            return False
        return True

    def _count(self, request: Request, who: Visitor | None) -> contextlib.AbstractContextManager[None]:
        stays = who is not None and _STAYS.fullmatch(request.url.path) is not None
        if who is not None:
            return self._limits.request(f"account {who.user}", ACCOUNT, stays)
        return self._limits.request(network_of(request.client.host if request.client else ""), STRANGER)

    async def _at_once(self, request: Request, who: Visitor) -> Response:
        must_mean_it(request, who)
        if request.method == "PUT":
            self._lab.lock.require(who)
            return Response(status_code=204)
        return JSONResponse({"left_on": await asyncio.wrap_future(self._lab.emergency.order(who))})
