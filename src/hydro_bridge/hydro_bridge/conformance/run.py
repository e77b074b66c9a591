# SPDX-License-Identifier: Apache-2.0
"""Carries the cases out, one conversation each, and says what was found."""

from __future__ import annotations

import struct
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from random import Random
from typing import Any
from zlib import crc32

from cobs import cobs

from hydro_bridge.conformance import checks
from hydro_bridge.conformance.host import Host, SilentError, changed
from hydro_bridge.conformance.script import Case, Step
from hydro_bridge.serial.protocol import VERSION, encode_command, encode_hello
from hydro_bridge.signals import Command

_ANSWER = 300
"""Samples within which a HELLO must be answered."""

PASS, FAIL, LEFT_OUT = "pass", "FAIL", "left out"


@dataclass(frozen=True)
class Result:
    """What came of a case."""

    case: Case
    outcome: str
    """`PASS`, `FAIL` or `LEFT_OUT`."""
    found: str
    """Why it failed or was left out."""


def run(
    cases: Iterable[Case],
    make_host: Callable[[], Host],
    bench: Mapping[str, Any] | None,
    *,
    moving: bool,
) -> list[Result]:
    """All results in order; each case begins with a conversation of its own, which disarms, and ends disarmed."""
    return [_one(case, make_host(), bench, moving) for case in cases]


def _one(case: Case, host: Host, bench: Mapping[str, Any] | None, moving: bool) -> Result:
    if case.moving and not moving:
        return Result(case, LEFT_OUT, "may move the piston: --moving")
    if case.needs == "bench" and bench is None:
        return Result(case, LEFT_OUT, "needs the box's bench file: --bench")
    found = ""
    try:
        _begin(host)
        if case.needs == "version 2" and host.version < 2:
            return Result(case, LEFT_OUT, "the box speaks version 1")
        for step in case.steps:
            found = found or _carry_out(step, host, bench)
        _end(host)
    except SilentError as error:
        found = found or str(error)
    return Result(case, FAIL if found else PASS, found)


def _begin(host: Host) -> None:
    """Greet until the box answers, then send safe commands until it confirms one."""
    host.greet()
    for _ in range(3):
        for _ in range(_ANSWER):
            host.listen(1)
            if host.hello is not None:
                break
        else:
            host.greet()
            continue
        break
    else:
        raise SilentError(f"the box answered no HELLO within {3 * _ANSWER} samples")
    host.listen(2)
    host.version = min(VERSION, host.hello.version_max) if host.hello else 1
    host.command = Command()
    host.listen(20, host.send)
    host.command = Command()
    host.forget()


def _end(host: Host) -> None:
    """Leave the box disarmed, whatever the case did."""
    host.command = Command()
    host.listen(10, host.send)


def _carry_out(step: Step, host: Host, bench: Mapping[str, Any] | None) -> str:
    words = step.words
    if step.verb == "check":
        for name, parameters in words.items():
            if found := checks.CHECKS[name](host, bench, **(parameters or {})):
                return f"{name}: {found}"
        return ""
    _VERBS[step.verb](host, words)
    return ""


def _commands(host: Host, words: dict[str, Any]) -> None:
    """A command at once and behind every `every`-th sample, `times` of them each, for `samples`."""
    changes = {key: value for key, value in words.items() if key not in ("samples", "every", "times")}
    every, times, seen = int(words.get("every", 1)), int(words.get("times", 1)), 0

    def each() -> None:
        nonlocal seen
        seen += 1
        if seen % every == 0:
            for _ in range(times):
                host.send()

    host.mark()
    host.send(**changes)
    for _ in range(_ANSWER):  # a host that lags reads old samples first
        if host.confirmed(host.sent[host.marked_sent].sequence) < len(host.states):
            break
        host.listen(1, each)
    host.listen(int(words["samples"]), each)


def _once(host: Host, words: dict[str, Any]) -> None:
    """One command; `sequence` counts from the last one that was sent, 0 repeats it."""
    changes = {key: value for key, value in words.items() if key not in ("sequence", "samples")}
    before = host.sequence
    host.mark()
    host.send((before + int(words.get("sequence", 1))) % 2**32, **changes)
    if int(words.get("sequence", 1)) != 1 and not words.get("goes_on"):
        host.sequence = before
    host.listen(int(words.get("samples", 15)))


def _wait(host: Host, words: int) -> None:
    host.listen(int(words))


def _greet(host: Host, words: dict[str, Any]) -> None:
    """Greet as a host of the versions given."""
    low, high = words.get("versions", (1, VERSION))
    body = bytearray(cobs.decode(encode_hello(0, int(1e6 * host.clock()))[1:-1])[:-4])
    body[14:16] = bytes((low, high))
    host.mark()
    host.details, host.greeted_at = None, len(host.states)
    host.write(sealed(bytes(body)))
    host.listen(int(words.get("samples", 50)))


def _garbage(host: Host, words: dict[str, Any]) -> None:
    """Noise in front of a command, for so many samples; none of it is a frame."""
    random = Random(int(words["seed"]))
    changes = {key: value for key, value in words.items() if key not in ("samples", "seed", "longest")}
    host.command = changed(host.command, changes)
    host.mark()

    def each() -> None:
        host.write(random.randbytes(random.randint(1, int(words["longest"]))) + b"\0")
        host.send()

    host.listen(int(words["samples"]), each)
    host.listen(5)


def _damaged(host: Host, words: dict[str, Any]) -> None:
    """A command that would change the gains, damaged in a way that a box must notice."""
    changes = {key: value for key, value in words.items() if key != "how"}
    frame = encode_command(host.sequence + 1, 0, changed(Command(), changes), host.version)
    body = bytearray(cobs.decode(frame[1:-1])[:-4])
    how = str(words["how"])
    if how == "bit flipped":
        check = struct.pack("<I", crc32(body))
        body[8] ^= 0x10  # in its time
        wire = b"\0" + cobs.encode(bytes(body) + check) + b"\0"
    elif how == "truncated":
        wire = frame[:-9] + b"\0"
    elif how == "waveform 4":
        body[34] = 4
        wire = sealed(bytes(body))
    elif how == "too long":
        wire = sealed(bytes(body) + b"\x01")
    elif how == "too short":
        wire = sealed(bytes(body[:-4]))
    elif how == "version 9":
        body[0] = 9
        wire = sealed(bytes(body))
    else:
        body[1] = 200  # a type that is free for experiments
        wire = sealed(bytes(body))
    host.mark()
    host.write(wire)
    host.listen(10)


def sealed(body: bytes) -> bytes:
    """A frame around any body, with a check sum that holds."""
    stuffed: bytes = cobs.encode(body + struct.pack("<I", crc32(body)))
    return b"\0" + stuffed + b"\0"


_VERBS: dict[str, Callable[[Host, Any], None]] = {
    "commands": _commands,
    "once": _once,
    "wait": _wait,
    "greet": _greet,
    "garbage": _garbage,
    "damaged": _damaged,
}
