# SPDX-License-Identifier: Apache-2.0
"""Web server of the live page: its files and one WebSocket per viewer in a separate thread; authorisation of commands.

::

    publish(frames, welcome) ──> viewer 1     frames: sent to all viewers now
                             ──> viewer 2     welcome: sent first to a new viewer
                             ─x─ viewer 3     has not read `BACKLOG_MAX` bytes: gets no frames until it has
    act(text) <── command, from any viewer    answered independently, so that a disarm waits for nothing

No viewer can delay `publish`. Requests from a foreign page or under a foreign host name are refused, so that a page on
the internet cannot reach the plant through its visitor's browser. `authorize` accepts or refuses commands:

=========  ======================================  ==========================================
command    needs                                   what it does
=========  ======================================  ==========================================
disarm     nothing                                 valve current 0, whoever commands
arm        the token, the present epoch            arms for whoever commands
override   the token, the present epoch, gains     holds K_p and K_i instead of the policy's
release    the token, the present epoch            the policy acts again
end        the token, the present epoch            ends the run as Ctrl-C does
freeze     the token, the present epoch            holds the coefficients of the compensated law
adapt      the token, the present epoch            they follow the bench again
=========  ======================================  ==========================================

The epoch is the one that the page showed when the button was pressed: after a trip, a disarm or a change of holder the
plant has another one, and the command has no effect. The token keeps out those who can open the page but not read the
terminal.
"""

from __future__ import annotations

import asyncio
import hmac
import http
import math
import threading
from collections.abc import Callable, Sequence
from concurrent.futures import Future
from concurrent.futures import TimeoutError as FutureTimeoutError
from contextlib import suppress
from functools import partial
from importlib import resources
from ipaddress import ip_address
from pathlib import Path
from socket import gethostname
from typing import Annotated
from urllib.parse import urlsplit

import msgspec
from websockets.asyncio.server import Server, ServerConnection, broadcast, serve
from websockets.datastructures import Headers
from websockets.exceptions import ConnectionClosed
from websockets.http11 import Request, Response

from hydro_bridge.pages import environment
from hydro_core.errors import UserError

_ShortText = Annotated[str, msgspec.Meta(max_length=100)]
COMMANDS = ("disarm", "arm", "override", "release", "end", "freeze", "adapt")
COMMAND_SIZE_MAX = 1000
"""Maximum size of a command, bytes."""


class RefusedError(Exception):
    """A command is refused; the message is one clear sentence."""


class PageCommand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command sent by a page."""

    command: _ShortText
    number: int = 0
    """Number given by the page and returned with the answer."""
    epoch: _ShortText = ""
    """Epoch of the session that the page showed, in decimal: JavaScript would round it as a number."""
    token: _ShortText = ""
    kp: float = math.nan
    """Total K_p [1/s] of an override."""
    ki: float = math.nan
    """Total K_i [1/s^2] of an override."""
    seconds: float = math.nan
    """Duration of an override [s]; 0: until released."""


_DECODER = msgspec.json.Decoder(PageCommand)


def parse_command(text: str | bytes) -> PageCommand:
    """Parse a received command. Raises RefusedError: the text is not a command."""
    try:
        command = _DECODER.decode(text)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise RefusedError(f"not understood: {error}") from None
    if command.command not in COMMANDS:
        raise RefusedError(f"no such command: {command.command}")
    return command


def authorize(command: PageCommand, token: str, epoch: int) -> None:
    """Check token and epoch of a command.

    `token`: as the terminal shows it. `epoch`: the plant's present one, 0 if no plant has announced one. Raises
    RefusedError: the command is refused.
    """
    if command.command == "disarm":
        return
    if not hmac.compare_digest(command.token.encode(), token.encode()):
        raise RefusedError(f"{command.command} needs the token that the terminal shows")
    if not epoch:
        raise RefusedError("nothing was done: no plant runs here, or it has not said yet who may command it")
    if command.epoch != str(epoch):
        raise RefusedError(
            "nothing was done: the plant was disarmed, tripped or changed hands after this page showed it; "
            "look, and press again"
        )
    numbers = (command.kp, command.ki, command.seconds)
    if command.command == "override" and not all(map(math.isfinite, numbers)):
        raise RefusedError("override needs K_p, K_i and for how long; 0 s: until it is told otherwise")


PORT = 8765
"""Default port; if it is taken, any free one."""
VIEWERS_MAX = 16
"""Maximum number of simultaneous viewers."""
BACKLOG_MAX = 256 * 1024
"""Bytes queued for a viewer beyond which frames for it are dropped."""
COMMAND_TIMEOUT = 3.0
"""s, time-out of a command."""

_PENDING_MAX = 20  # pending commands of one viewer
_PAGE_FILES = ("page.css", "page.js", "plots.js", "series.js", "uPlot.iife.min.js", "uPlot.min.css")
_CONTENT_TYPES = {".css": "text/css; charset=utf-8", ".js": "text/javascript; charset=utf-8"}
_CONTENT_SECURITY_POLICY = (
    "default-src 'none'; script-src 'self'; style-src 'self' 'unsafe-inline'; img-src data:; connect-src 'self'"
)

Message = str | bytes


class PageServer:
    """Web server of the live page, which runs until `close`.

    `act`: executes a received command and returns the answer for the viewer; called in the server's thread. `host`,
    `port`: address to listen at; port None: `PORT`, or any free one. Raises UserError: the address cannot be listened
    at.
    """

    def __init__(self, act: Callable[[Message], Future[str]], host: str = "127.0.0.1", port: int | None = None) -> None:
        self._act, self._host = act, host
        folder, page = resources.files("hydro_bridge.dashboard") / "page", environment("hydro_bridge", "dashboard/page")
        self._files = {
            f"/{name}": ((folder / name).read_bytes(), _CONTENT_TYPES[Path(name).suffix]) for name in _PAGE_FILES
        }
        index = page.get_template("index.html").render(title="hydro")
        self._files["/"] = (index.encode(), "text/html; charset=utf-8")
        self._viewers: set[ServerConnection] = set()
        self._new: set[ServerConnection] = set()
        self._lock = threading.Lock()
        self._loop = asyncio.new_event_loop()
        try:
            self._server = self._loop.run_until_complete(self._listen(host, port))
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

    def publish(self, frames: Sequence[Message], welcome: Callable[[], Sequence[Message]]) -> None:
        """Send `frames` to all viewers, and first `welcome()` to new ones; thread-safe, returns at once."""
        with self._lock:
            new, self._new = self._new, set()
        if new or self._viewers:
            first = welcome() if new else ()
            self._loop.call_soon_threadsafe(self._send, new, first, frames)

    def close(self) -> None:
        """Close all connections and end the thread."""
        self._loop.call_soon_threadsafe(self._server.close)
        with suppress(FutureTimeoutError, asyncio.TimeoutError):
            closed = asyncio.wait_for(self._server.wait_closed(), 2.0)
            asyncio.run_coroutine_threadsafe(closed, self._loop).result(5.0)
        self._loop.call_soon_threadsafe(self._loop.stop)
        self._thread.join(5.0)
        self._loop.close()

    async def _listen(self, host: str, port: int | None) -> Server:
        listen = partial(
            serve, self._attend, host, process_request=self._answer, compression=None, max_size=COMMAND_SIZE_MAX,
            ping_interval=5.0, ping_timeout=5.0, close_timeout=0.5, server_header=None,
        )  # fmt: skip
        try:
            return await listen(port=PORT if port is None else port)
        except OSError:
            if port is not None:
                raise
            return await listen(port=0)

    def _answer(self, connection: ServerConnection, request: Request) -> Response | None:
        """Return the page's files; None for its WebSocket, which the library handles."""
        if is_cross_origin(request, self._host):
            return connection.respond(http.HTTPStatus.FORBIDDEN, "another page may not talk to this one\n")
        path = urlsplit(request.path).path
        if path == "/live":
            if self.viewers < VIEWERS_MAX:
                return None
            return connection.respond(http.HTTPStatus.SERVICE_UNAVAILABLE, f"{VIEWERS_MAX} viewers look already\n")
        if path not in self._files:
            return connection.respond(http.HTTPStatus.NOT_FOUND, "no such page\n")
        return file_response(*self._files[path], _CONTENT_SECURITY_POLICY)

    async def _attend(self, viewer: ServerConnection) -> None:
        with self._lock:
            self._new.add(viewer)
        tasks: set[asyncio.Task[None]] = set()
        try:
            async for text in viewer:
                if len(tasks) >= _PENDING_MAX:  # reading pauses meanwhile
                    await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
                tasks.add(task := asyncio.create_task(self._command(viewer, text)))
                task.add_done_callback(tasks.discard)
        except ConnectionClosed:
            pass
        finally:
            with self._lock:
                self._new.discard(viewer)
                self._viewers.discard(viewer)

    async def _command(self, viewer: ServerConnection, text: Message) -> None:
        answer = await asyncio.wrap_future(self._act(text))
        with suppress(ConnectionClosed):
            await viewer.send(answer)

    def _send(self, new: set[ServerConnection], first: Sequence[Message], frames: Sequence[Message]) -> None:
        for message in first:
            broadcast(new, message)
        with self._lock:
            self._viewers |= {viewer for viewer in new if viewer.state == viewer.state.OPEN}
        reading = [viewer for viewer in self._viewers if viewer.transport.get_write_buffer_size() < BACKLOG_MAX]
        for message in frames:
            broadcast(reading, message)


def file_response(body: bytes, kind: str, policy: str) -> Response:
    """Return an HTTP response with a file; `kind`: content type, `policy`: content security policy."""
    headers = {
        "Content-Type": kind,
        "Content-Length": str(len(body)),
        "Cache-Control": "no-store",
        "Connection": "close",
        "Content-Security-Policy": policy,
        "X-Content-Type-Options": "nosniff",
        "X-Frame-Options": "DENY",
    }
    return Response(200, "OK", Headers(headers), body)


def is_cross_origin(request: Request, given: str) -> bool:
    """Return whether a request has another site's Origin, or a Host that is not this machine."""
    host, origin = request.headers.get("Host", ""), request.headers.get("Origin")
    name = urlsplit(f"//{host}").hostname or ""
    if name not in ("localhost", given.lower(), gethostname().lower()):  # else an IP address, against DNS rebinding
        try:
            ip_address(name)
        except ValueError:
            return True
    return origin is not None and urlsplit(origin).netloc != host
