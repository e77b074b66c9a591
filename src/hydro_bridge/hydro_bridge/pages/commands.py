# SPDX-License-Identifier: Apache-2.0
"""Commands of the live page, and who may give them.

Everyone may disarm. Each other command needs the token, which keeps out those who can open the page but not read the
terminal, and the present epoch, the one that the page showed when the button was pressed: after a trip, a disarm or a
change of holder the plant has another one, and the command has no effect.
"""

from __future__ import annotations

import asyncio
import hmac
import math
from collections.abc import Awaitable, Callable
from contextlib import suppress
from typing import Literal

import msgspec
from websockets.asyncio.server import ServerConnection
from websockets.exceptions import ConnectionClosed

from hydro_bridge.pages.server import encode_message
from hydro_core.errors import UserError

COMMAND_SIZE_MAX = 1000
"""Maximum size of a command, bytes."""
COMMAND_TIMEOUT = 3.0
"""s, time-out of a command."""


class PageCommand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command sent by a page."""

    command: Literal["disarm", "arm", "override", "release", "end", "freeze", "adapt"]
    epoch: str = ""
    """Epoch of the session that the page showed, in decimal: JavaScript would round it as a number."""
    token: str = ""
    kp: float = math.nan
    """Total K_p [1/s] of an override."""
    ki: float = math.nan
    """Total K_i [1/s^2] of an override."""
    seconds: float = math.nan
    """Duration of an override [s]; 0: until released."""


def authorize(command: PageCommand, token: str, epoch: int) -> None:
    """Check token and epoch of a command.

    `token`: as the terminal shows it. `epoch`: the plant's present one, 0 if no plant has announced one. Raises
    UserError: the command is refused.
    """
    if command.command == "disarm":
        return
    if not hmac.compare_digest(command.token.encode(), token.encode()):
        raise UserError(f"{command.command} needs the token that the terminal shows")
    if not epoch:
        raise UserError("nothing was done: no plant here has said who may command it")
    if command.epoch != str(epoch):
        raise UserError("nothing was done: the plant was disarmed, tripped or changed hands: look, and press again")
    if command.command == "override" and not math.isfinite(command.kp + command.ki + command.seconds):
        raise UserError("override needs K_p, K_i and for how long (0 s: until released)")


async def answer_commands(
    viewer: ServerConnection, execute: Callable[[PageCommand], Awaitable[tuple[bool, str]]]
) -> None:
    """Execute the commands of one viewer until it leaves, each on its own, so that a disarm waits for nothing.

    `execute`: returns success and a sentence. May raise UserError.
    """

    async def answer(text: str | bytes) -> None:
        name, success = "", False
        try:
            command = msgspec.json.decode(text, type=PageCommand)
            name = command.command
            success, message = await asyncio.wait_for(execute(command), COMMAND_TIMEOUT)
        except (UserError, msgspec.DecodeError, UnicodeError) as refused:
            message = str(refused)
        except asyncio.TimeoutError:
            message = f"no answer within {COMMAND_TIMEOUT:g} s"
        with suppress(ConnectionClosed):
            await viewer.send(encode_message("answer", command=name, success=success, text=message))

    tasks: set[asyncio.Task[None]] = set()
    async for text in viewer:
        if len(tasks) >= 20:  # reading pauses meanwhile
            await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
        tasks.add(task := asyncio.create_task(answer(text)))
        task.add_done_callback(tasks.discard)
