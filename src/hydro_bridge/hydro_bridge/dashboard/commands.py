# SPDX-License-Identifier: Apache-2.0
"""Which commands of a page are carried out: rules without ROS.

=========  ======================================  ==========================================
command    needs                                   what it does
=========  ======================================  ==========================================
disarm     nothing                                 valve current 0, whoever commands
arm        the token, the present epoch            arms for whoever commands
override   the token, the present epoch, gains     holds K_p and K_i instead of the policy's
release    the token, the present epoch            the policy acts again
end        the token, the present epoch            ends the run as Ctrl-C does
=========  ======================================  ==========================================

The epoch is the one that the page showed when its person pressed: behind a trip, a disarm or another holder it is
another one, and the command does nothing. The token keeps out whoever can open the page but not read the terminal.
"""

from __future__ import annotations

import hmac
import math
import secrets
from typing import Annotated

import msgspec

_TEXT = Annotated[str, msgspec.Meta(max_length=100)]
COMMANDS = ("disarm", "arm", "override", "release", "end")
SIZE_MAX = 1000
"""Bytes of a command."""


class RefusedError(Exception):
    """A command is not carried out; the message is one clear sentence."""


class PageCommand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """What a page sends."""

    command: _TEXT
    number: int = 0
    """Of the page; the answer carries it."""
    epoch: _TEXT = ""
    """Of the session that the page showed, in decimal: as a number JavaScript would round it."""
    token: _TEXT = ""
    kp: float = math.nan
    """K_p in all [1/s], of an override."""
    ki: float = math.nan
    """K_i in all [1/s^2]."""
    seconds: float = math.nan
    """How long an override lasts [s]; 0: until told otherwise."""


_DECODER = msgspec.json.Decoder(PageCommand)


def read(text: str | bytes) -> PageCommand:
    """A command as it came.

    Raises
    ------
    RefusedError
        It is none.
    """
    try:
        command = _DECODER.decode(text)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise RefusedError(f"not understood: {error}") from None
    if command.command not in COMMANDS:
        raise RefusedError(f"no such command: {command.command}")
    return command


class Rules:
    """What one run of the dashboard lets a page do.

    Parameters
    ----------
    token
        That the terminal shows; drawn if there is none.
    """

    def __init__(self, token: str = "") -> None:
        self.token = token or secrets.token_urlsafe(9)

    def check(self, command: PageCommand, epoch: int) -> None:
        """Let a command pass, or not; `epoch` is the plant's present one, 0 if no plant has said any.

        Raises
        ------
        RefusedError
            It does nothing.
        """
        if command.command == "disarm":
            return
        if not hmac.compare_digest(command.token.encode(), self.token.encode()):
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
