# SPDX-License-Identifier: Apache-2.0
"""Web server of a page: its files, and a WebSocket per viewer, in a separate thread.

::

    publish(frames, welcome) ──> viewer 1     frames: sent to all viewers now
                             ──> viewer 2     welcome: sent first to a new viewer
                             ─x─ viewer 3     has not read `BACKLOG_MAX` bytes: gets no frames until it has
    attend(viewer) <── messages of a viewer

No viewer can delay `publish`. Requests from a foreign page or under a foreign host name are refused, so that a page on
the internet reaches nothing here through its visitor's browser.
"""

from __future__ import annotations

import asyncio
import http
import logging
import mimetypes
import threading
from collections.abc import Awaitable, Callable, Mapping, Sequence
from contextlib import suppress
from ipaddress import ip_address
from socket import gethostname
from typing import Any
from urllib.parse import urlsplit

import msgspec
from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from hydro_core.errors import UserError

HOST = "127.0.0.1"
PORT = 8765
"""Default port; if it is taken, any free one."""
VIEWERS_MAX = 16
"""Maximum number of simultaneous viewers."""
_LOGGER = logging.getLogger(__name__)
_LOGGER.setLevel(logging.CRITICAL)  # the library would log a traceback for each that speaks no HTTP
BACKLOG_MAX = 256 * 1024
"""Bytes queued for a viewer beyond which frames for it are dropped."""


def encode_message(kind: str, **content: Any) -> str:
    """Encode a message to the page; non-finite values become null."""
    return msgspec.json.encode({"kind": kind, **content}).decode()


class PageServer:
    """Server of a page, which runs until `close`.

    `files`: content by path, "/" for the page itself. `attend`: converses with one viewer until it leaves. `policy`:
    content security policy. `message_size_max`: of a viewer's messages, bytes. `host`, `port`: address to listen at;
    port None: `PORT`, or any free one. Raises UserError: the address cannot be listened at.
    """

    def __init__(
        self,
        files: Mapping[str, bytes],
        attend: Callable[[ServerConnection], Awaitable[None]],
        *,
        policy: str,
        message_size_max: int,
        host: str = HOST,
        port: int | None = None,
    ) -> None:
        self._files, self._talk, self._policy, self._host = files, attend, policy, host
        self._viewers: set[ServerConnection] = set()  # both change in the server's thread alone
        self._new: set[ServerConnection] = set()
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(self._listen(port, message_size_max))
        except OSError as error:
            self._loop.close()
            where = f"{host} port {port}" if port else host
            raise UserError(f"the page cannot be served at {where}: {error.strerror or error}") from None
        self.port: int = next(iter(self._server.sockets)).getsockname()[1]
        self.address = f"http://{f'[{host}]' if ':' in host else host}:{self.port}/"
        """Address of the page."""
        self._thread = threading.Thread(target=self._loop.run_forever, name="page server", daemon=True)
        self._thread.start()

    @property
    def viewers(self) -> int:
        """Number of viewers."""
        return len(self._viewers) + len(self._new)

    def publish(self, frames: Sequence[str | bytes], welcome: Callable[[], Sequence[str | bytes]]) -> None:
        """Send `frames` to all viewers, and first `welcome()` to new ones; thread-safe, returns at once."""
        if self.viewers:
            self._loop.call_soon_threadsafe(self._send, welcome() if self._new else None, frames)

    def close(self) -> None:
        """Close all connections and end the thread."""

        async def end() -> None:
            self._server.close()
            with suppress(asyncio.TimeoutError):
                await asyncio.wait_for(self._server.wait_closed(), 2.0)
            self._loop.stop()

        asyncio.run_coroutine_threadsafe(end(), self._loop)
        self._thread.join(5.0)
        self._loop.close()

    async def _listen(self, port: int | None, size: int) -> Server:
        try:
            return await serve(
                self._attend, self._host, PORT if port is None else port, process_request=self._answer,
                compression=None, max_size=size, ping_interval=5.0, close_timeout=0.5, server_header=None,
                logger=_LOGGER,
            )  # fmt: skip
        except OSError:
            if port is not None:
                raise
            return await self._listen(0, size)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the page's files; None for its WebSocket, which the library handles."""
        path = urlsplit(request.path).path
        if _is_cross_origin(request, self._host):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "another page may not talk to this one\n")
        if path in ("/", "/socket") and self.viewers >= VIEWERS_MAX:
            said = f"{VIEWERS_MAX} pages look already: close one of them, then reload this one\n"
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, said)
        if path == "/socket":
            return None
        if path not in self._files:
            return connection.respond(http.HTTPStatus.NOT_FOUND, "no such page\n")
        headers = {
            "Content-Type": f"{mimetypes.guess_type(path)[0] or 'text/html'}; charset=utf-8",
            "Content-Length": str(len(self._files[path])),
            "Cache-Control": "no-store",
            "Connection": "close",
            "Content-Security-Policy": self._policy,
            "X-Content-Type-Options": "nosniff",
            "X-Frame-Options": "DENY",
        }
        return Response(200, "OK", Headers(headers), self._files[path])

    async def _attend(self, viewer: ServerConnection) -> None:
        self._new.add(viewer)
        try:
            with suppress(ConnectionClosed):
                await self._talk(viewer)
        finally:
            self._new.discard(viewer)
            self._viewers.discard(viewer)

    def _send(self, first: Sequence[str | bytes] | None, frames: Sequence[str | bytes]) -> None:
        if first is not None:
            for message in first:
                broadcast(self._new, message)
            self._viewers |= self._new
            self._new.clear()
        reading = [viewer for viewer in self._viewers if viewer.transport.get_write_buffer_size() < BACKLOG_MAX]
        for message in frames:
            broadcast(reading, message)


def _is_cross_origin(request: Request, given: str) -> bool:
    """Return whether a request has another site's Origin, or a Host that is not this machine."""
    host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
    name = urlsplit(f"//{host}").hostname or ""
    if name not in ("localhost", given.lower(), gethostname().lower()):  # else an IP address, against DNS rebinding
        try:
            ip_address(name)
        except ValueError:
            return True
    return origin is not None and urlsplit(origin).netloc != host
