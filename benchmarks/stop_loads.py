"""Whoever asks too much of the lab server, in a process of its own; it loads little, so that it begins at once."""

import asyncio
import contextlib
import json
import resource
import signal
import ssl
import sys
from typing import Any, Final
from urllib.parse import urlsplit

from benchmarks.lab_tls import unverified

LOADS: Final = ("watchers", "clouds", "sign-ins", "half-open", "full disk", "batch")
# Projects whose clouds are asked for.
PROJECTS: Final = 60
# A socket that was ended comes again after this time: 2000 of them are some 250 connections a second for ever.
_AGAIN_S: Final = 5.0


class _Load:
    """What others do, for as long as they are let."""

    def __init__(self, url: str, token: str, sizes: dict[str, int]):
        self._url, self._token, self._sizes = urlsplit(url), token, sizes
        self._tls = unverified() if self._url.scheme == "https" else None
        self.tasks: list[asyncio.Task[Any]] = []
        self.child: asyncio.subprocess.Process | None = None

    async def begin(self, load: str) -> None:
        """Begin with one kind."""
        if load == "batch":
            work = "import time, numpy as np\nwhile True:\n    np.linalg.svd(np.random.rand(300, 300))"
            self.child = await asyncio.create_subprocess_exec(sys.executable, "-c", work)
        elif load == "watchers":
            for _ in range(self._sizes[load]):
                for path in ("events", "pictures"):
                    self._go(self._watch(f"/api/{path}"))
        elif load == "clouds":
            for i in range(self._sizes[load]):
                self._go(self._ask(f"/api/projects/kept{i % PROJECTS}/cloud.ply"))
        elif load == "sign-ins":
            self._go(self._sign_in(self._sizes[load]))
        elif load == "half-open":
            for i in range(self._sizes[load]):
                # Every other one says no word of TLS.
                self._go(self._half(self._tls if i % 2 else None))

    def _go(self, work: Any) -> None:
        self.tasks.append(asyncio.create_task(work))

    async def _said(self, words: str, **how: Any) -> tuple[asyncio.StreamReader, asyncio.StreamWriter]:
        how = {"ssl": self._tls, **how}
        reader, writer = await asyncio.open_connection(self._url.hostname, self._url.port, **how)
        writer.write(words.encode())
        return reader, writer

    async def _watch(self, path: str) -> None:
        head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {self._token}\r\n\r\n"
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await self._said(head)
                while await reader.read(1 << 16):
                    pass
                writer.close()
            await asyncio.sleep(0.5)

    async def _ask(self, path: str) -> None:
        """One cloud after the other, as soon as the answer is there; a refusal is answered by patience of its own."""
        head = f"GET {path} HTTP/1.1\r\nHost: 127.0.0.1\r\nAuthorization: Bearer {self._token}\r\n"
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await self._said(head + "Connection: close\r\n\r\n")
                while await reader.read(1 << 16):
                    pass
                writer.close()
            await asyncio.sleep(0.5)

    async def _sign_in(self, each_second: int) -> None:
        """Wrong passwords at a pace, whatever becomes of them; each address of the loopback network may try a few."""
        body = "name=nobody{}&password=wrong-password&form=made-up"
        count = 0
        waiting: set[asyncio.Task[None]] = set()

        async def one(i: int) -> None:
            with contextlib.suppress(OSError):
                text = body.format(i)
                local = f"127.{1 + i % 200}.{1 + i // 200 % 200}.1"
                head = "POST /sign-in HTTP/1.1\r\nHost: 127.0.0.1\r\nCookie: scanner_form=made-up\r\n"
                words = f"{head}Content-Length: {len(text)}\r\nConnection: close\r\n\r\n{text}"
                reader, writer = await self._said(words, local_addr=(local, 0))
                while await reader.read(1 << 16):
                    pass
                writer.close()

        while True:
            count += 1
            if len(waiting) < 4 * each_second:
                task = asyncio.create_task(one(count))
                waiting.add(task)
                task.add_done_callback(waiting.discard)
            await asyncio.sleep(1 / each_second)

    async def _half(self, tls: ssl.SSLContext | None) -> None:
        """Half a request, and again a while after the server has had enough of it."""
        while True:
            with contextlib.suppress(OSError):
                reader, writer = await self._said("GET /api/me HTTP/1.1\r\nHost: 127.0.0.1\r\nX-Half: ", ssl=tls)
                while await reader.read(1 << 10):
                    pass
                writer.close()
            await asyncio.sleep(_AGAIN_S)


async def _work(url: str, tokens: list[str], loads: list[str], sizes: dict[str, int]) -> None:
    load = _Load(url, tokens[2], sizes)
    try:
        for kind in loads:
            await load.begin(kind)
        await asyncio.sleep(2.0)
        print("loading", flush=True)
        await asyncio.Event().wait()
    finally:
        if load.child is not None:
            load.child.kill()


if __name__ == "__main__":
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (min(hard, max(soft, 8192)), hard))
    # Whoever began this ends it; the process of the batch job ends with it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit())
    asyncio.run(_work(sys.argv[1], *json.loads(sys.argv[2])))
