# SPDX-License-Identifier: Apache-2.0
"""Conversation with a box: its begin and end, and the steps of a case, some of them damaged frames or garbage."""

from __future__ import annotations

import struct
from collections.abc import Callable
from random import Random
from typing import Any
from zlib import crc32

from cobs import cobs

from hydro_bridge.conformance.host import Host, SilentError, changed
from hydro_bridge.serial.protocol import VERSION, encode_command, encode_hello
from hydro_bridge.signals import Command

_TIME, _WAVEFORM, _VERSION, _TYPE = 8, 34, 0, 1
"""Byte offsets in a frame's body."""
_CHANGED = {"waveform 4": (_WAVEFORM, 4), "version 9": (_VERSION, 9), "type 200": (_TYPE, 200)}
"""Offset and value of each change; the types from 200 are free for experiments."""


def damaged(frame: bytes, how: str) -> bytes:
    """Return the frame damaged by `how`: `bit flipped`, `truncated`, `too long`, `too short`, or one of `_CHANGED`.

    All but the first two have a valid check sum. Raises KeyError for an unknown kind of damage.
    """
    if how == "truncated":
        return frame[:-9] + b"\0"
    body = bytearray(cobs.decode(frame[1:-1])[:-4])
    if how == "bit flipped":
        check = crc32(body)
        body[_TIME] ^= 0x10
        return _wrapped(bytes(body), check)
    if how == "too long":
        body.append(1)
    elif how == "too short":
        del body[-4:]
    else:
        place, value = _CHANGED[how]
        body[place] = value
    return sealed(bytes(body))


def sealed(body: bytes) -> bytes:
    """Return a frame around any body, with a valid check sum."""
    return _wrapped(body, crc32(body))


def _wrapped(body: bytes, check: int) -> bytes:
    stuffed: bytes = cobs.encode(body + struct.pack("<I", check))
    return b"\0" + stuffed + b"\0"


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


def _commands(host: Host, words: dict[str, Any]) -> None:
    """Send a command at once and after every `every`-th sample, `times` times each, for `samples`."""
    changes = _changes(host, words, "samples", "every", "times")
    every, times, seen = int(words.get("every", 1)), int(words.get("times", 1)), 0

    def each() -> None:
        nonlocal seen
        seen += 1
        if seen % every == 0:
            for _ in range(times):
                host.send()

    host.mark()
    host.send(**changes)
    until_confirmed(host, each)
    host.listen(int(words["samples"]), each)


def _once(host: Host, words: dict[str, Any]) -> None:
    """Send one command; `sequence` counts from the last one sent, 0 repeats it."""
    changes = _changes(host, words, "sequence", "samples", "goes_on")
    before, step = host.sequence, int(words.get("sequence", 1))
    host.mark()
    host.send((before + step) % 2**32, **changes)
    samples = int(words.get("samples", 15))
    if step == 1 or words.get("goes_on"):
        until_confirmed(host)
    else:  # never confirmed: wait for it to arrive
        host.sequence = before
        samples += host.lag
    host.listen(samples)


def _wait(host: Host, words: int) -> None:
    host.listen(int(words))


def _greet(host: Host, words: dict[str, Any]) -> None:
    """Greet as a host of the given versions; checks begin after the answer, if there is one."""
    low, high = words.get("versions", (1, VERSION))
    body = bytearray(cobs.decode(encode_hello(0, int(1e6 * host.clock()))[1:-1])[:-4])
    body[14:16] = bytes((low, high))
    host.mark()
    host.details, host.law, host.greeted_at = None, None, len(host.states)
    host.write(sealed(bytes(body)))
    for _ in range(ANSWER):
        if host.hellos and host.hellos[-1][0] >= host.greeted_at:
            host.mark()
            host.marked = host.hellos[-1][0]
            break
        host.listen(1)
    host.listen(int(words.get("samples", 50)))


def _garbage(host: Host, words: dict[str, Any]) -> None:
    """Send noise, none of it a frame, before a command after every `every`-th sample, for a number of samples."""
    random, seen = Random(int(words["seed"])), 0
    host.command = changed(host.command, _changes(host, words, "samples", "every", "seed", "longest"))
    host.mark()

    def each() -> None:
        nonlocal seen
        seen += 1
        if seen % int(words["every"]) == 0:
            host.write(random.randbytes(random.randint(1, int(words["longest"]))) + b"\0")
            host.send()

    host.listen(int(words["samples"]), each)
    host.listen(5 + host.lag)


def _damaged(host: Host, words: dict[str, Any]) -> None:
    """Send a command that would change the gains, damaged in a way that a box must detect."""
    changes = {key: value for key, value in words.items() if key != "how"}
    frame = encode_command(host.sequence + 1, 0, changed(Command(), changes), host.version)
    host.mark()
    host.write(damaged(frame, str(words["how"])))
    host.listen(10 + host.lag)


def _changes(host: Host, words: dict[str, Any], *others: str) -> dict[str, Any]:
    """Return the words that change a command; a number may be given by the name of an entry of DETAILS."""
    changes = {key: value for key, value in words.items() if key not in others}
    for key, value in changes.items():
        if key not in ("waveform", "law") and isinstance(value, str):
            changes[key] = getattr(host.details.details, value) if host.details else 0.0
    return changes


VERBS: dict[str, Callable[[Host, Any], None]] = {
    "commands": _commands,
    "once": _once,
    "wait": _wait,
    "greet": _greet,
    "garbage": _garbage,
    "damaged": _damaged,
}
