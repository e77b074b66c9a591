# SPDX-License-Identifier: Apache-2.0
"""Rules by which commands from a page are accepted or refused, without ROS.

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

import hmac
import math
import secrets
from typing import Annotated

import msgspec

_TEXT = Annotated[str, msgspec.Meta(max_length=100)]
COMMANDS = ("disarm", "arm", "override", "release", "end", "freeze", "adapt")
SIZE_MAX = 1000
"""Maximum size of a command, bytes."""


class RefusedError(Exception):
    """A command is refused; the message is one clear sentence."""


class PageCommand(msgspec.Struct, frozen=True, kw_only=True, forbid_unknown_fields=True):
    """A command sent by a page."""

    command: _TEXT
    number: int = 0
    """Number given by the page and returned with the answer."""
    epoch: _TEXT = ""
    """Epoch of the session that the page showed, in decimal: JavaScript would round it as a number."""
    token: _TEXT = ""
    kp: float = math.nan
    """Total K_p [1/s] of an override."""
    ki: float = math.nan
    """Total K_i [1/s^2] of an override."""
    seconds: float = math.nan
    """Duration of an override [s]; 0: until released."""


_DECODER = msgspec.json.Decoder(PageCommand)


def read(text: str | bytes) -> PageCommand:
    """Parse a received command.

    Raises
    ------
    RefusedError
        The text is not a command.
    """
    try:
        command = _DECODER.decode(text)
    except (msgspec.DecodeError, UnicodeError) as error:
        raise RefusedError(f"not understood: {error}") from None
    if command.command not in COMMANDS:
        raise RefusedError(f"no such command: {command.command}")
    return command


class Rules:
    """Access rules of one run of the dashboard.

    Parameters
    ----------
    token
        Token shown on the terminal; drawn at random if not given.
    """

    def __init__(self, token: str = "") -> None:
        self.token = token or secrets.token_urlsafe(9)

    def check(self, command: PageCommand, epoch: int) -> None:
        """Accept or refuse a command; `epoch` is the plant's present one, 0 if no plant has announced one.

        Raises
        ------
        RefusedError
            The command is refused.
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
