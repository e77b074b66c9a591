# SPDX-License-Identifier: Apache-2.0
"""Start and end of a conversation with a box, and confirmation of its commands."""

from __future__ import annotations

from collections.abc import Callable

from hydro_bridge.conformance.host import Host, SilentError
from hydro_bridge.serial.protocol import VERSION
from hydro_bridge.signals import Command

ANSWER = 300
"""Samples within which a HELLO must be answered, and a command confirmed."""
_APART = 1000
"""Offset of a conversation's sequence numbers from those of the previous one."""


def begin(host: Host) -> None:
    """Greet until the box answers, then send safe commands until it confirms one."""
    host.greet()
    for _ in range(3):
        for _ in range(ANSWER):
            host.listen(1)
            if host.hello is not None:
                break
        else:
            host.greet()
            continue
        break
    else:
        raise SilentError(f"the box answered no HELLO within {3 * ANSWER} samples")
    host.listen(2)
    host.version = min(VERSION, host.hello.version_max) if host.hello else 1
    host.sequence = (host.states[-1].last_command + _APART) % 2**32  # not a number of the previous conversation
    host.command = Command()
    host.mark()
    host.send()
    host.lag = until_confirmed(host, host.send)
    host.listen(20, host.send)
    host.command = Command()
    host.forget()


def until_confirmed(host: Host, each: Callable[[], None] | None = None) -> int:
    """Wait until the step's first command, or a later one, is confirmed; return the delay in samples."""
    first = host.sent[host.marked_sent]
    for _ in range(ANSWER):  # a lagging host reads old samples first, and the line may buffer bytes
        if (at := host.confirmed(first.sequence)) < len(host.states):
            return at - first.after
        host.listen(1, each)
    return 0


def end(host: Host) -> None:
    """Disarm the box, whatever the case did."""
    host.command = Command()
    host.listen(10, host.send)
