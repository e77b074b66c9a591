# SPDX-License-Identifier: Apache-2.0
"""Commands of the live page, and who may give them.

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
import math
from collections.abc import Awaitable, Callable
from concurrent.futures import Future
from contextlib import suppress
from typing import Annotated

import msgspec
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from hydro_bridge.pages.server import encode_message

_ShortText = Annotated[str, msgspec.Meta(max_length=100)]
COMMANDS = ("disarm", "arm", "override", "release", "end", "freeze", "adapt")
COMMAND_SIZE_MAX = 1000
"""Maximum size of a command, bytes."""
COMMAND_TIMEOUT = 3.0
"""s, time-out of a command."""


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


def parse_command(text: str | bytes) -> PageCommand:
    """Parse a received command. Raises RefusedError: the text is not a command."""
    try:
        command = msgspec.json.decode(text, type=PageCommand)
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
        raise RefusedError("nothing was done: no plant here has said who may command it")
    if command.epoch != str(epoch):
        raise RefusedError("nothing was done: the plant was disarmed, tripped or changed hands: look, and press again")
    numbers = (command.kp, command.ki, command.seconds)
    if command.command == "override" and not all(map(math.isfinite, numbers)):
        raise RefusedError("override needs K_p, K_i and for how long (0 s: until released)")


def answer_commands(
    execute: Callable[[PageCommand], Future[tuple[bool, str]]],
) -> Callable[[ServerConnection], Awaitable[None]]:
    """Return the `attend` of a `PageServer` that executes commands and sends the answers.

    `execute`: called in the server's thread; its result is success and a sentence. May raise RefusedError. Each command
    is answered independently, so that a disarm waits for nothing.
    """

    async def answer(viewer: ServerConnection, text: str | bytes) -> None:
        command, success = PageCommand(command=""), False
        try:
            command = parse_command(text)
            success, message = await asyncio.wait_for(asyncio.wrap_future(execute(command)), COMMAND_TIMEOUT)
        except RefusedError as refused:
            message = str(refused)
        except asyncio.TimeoutError:
            message = f"no answer within {COMMAND_TIMEOUT:g} s"
        content = {"number": command.number, "command": command.command, "success": success, "text": message}
        with suppress(ConnectionClosed):
            await viewer.send(encode_message("answer", content))

    async def attend(viewer: ServerConnection) -> None:
        tasks: set[asyncio.Task[None]] = set()
        async for text in viewer:
            if len(tasks) >= 20:  # reading pauses meanwhile
                await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            tasks.add(task := asyncio.create_task(answer(viewer, text)))
            task.add_done_callback(tasks.discard)

    return attend
