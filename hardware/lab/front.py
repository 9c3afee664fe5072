"""What comes before everything else: Stop and the operator's renewal, in the thread that reads requests.

Both know in memory who asks, and wait for nothing that another request can hold; the rest of the interface is behind
them.
"""

import asyncio
from typing import Final

from starlette.requests import Request
from starlette.responses import JSONResponse, Response
from starlette.types import ASGIApp, Receive, Scope, Send

from hardware.lab.badges import Visitor
from hardware.lab.lab import Lab
from hardware.lab.refusal import Refusal
from hardware.lab.web import known_visitor, must_mean_it, refused

_STOP: Final = ("POST", "/api/stop")
_RENEW: Final = ("PUT", "/api/lock")


class Front:
    """Answers what cannot wait, and passes on the rest.

    Args:
        app: for the rest.
        lab: whose.
    """

    def __init__(self, app: ASGIApp, lab: Lab):
        self._app, self._lab = app, lab

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Serve one request."""
        if scope["type"] != "http":
            await self._app(scope, receive, send)
            return
        request = Request(scope)
        answer = None
        try:
            who = known_visitor(request, self._lab)
            # Whoever is not known here may be by now, and is looked for where that may take time.
            if who is not None and (scope["method"], scope["path"]) in (_STOP, _RENEW):
                answer = await self._at_once(request, who)
        except Refusal as refusal:
            answer = refused(request, refusal)
        await (answer or self._app)(scope, receive, send)

    async def _at_once(self, request: Request, who: Visitor) -> Response:
        must_mean_it(request, who)
        if request.method == "PUT":
            self._lab.lock.require(who)
            return Response(status_code=204)
        return JSONResponse({"left_on": await asyncio.wrap_future(self._lab.emergency.order(who))})
