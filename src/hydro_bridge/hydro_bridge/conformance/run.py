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
from hydro_bridge.conformance.host import PUNCTUAL, Host, SilentError, UnreadableError, changed
from hydro_bridge.conformance.readings import NotToldError
from hydro_bridge.conformance.script import Case
from hydro_bridge.serial.protocol import VERSION, encode_command, encode_hello
from hydro_bridge.signals import Command

_ANSWER = 300
"""Samples within which a HELLO must be answered, and a command confirmed."""
_APART = 1000
"""By how much the numbers of a conversation are ahead of those of the one before."""

PASS, FAIL, LEFT_OUT, NOT_JUDGED = "pass", "FAIL", "left out", "not judged"


@dataclass(frozen=True)
class Result:
    """What came of a case."""

    case: Case
    outcome: str
    """`PASS`, `FAIL`, `LEFT_OUT` or `NOT_JUDGED`."""
    found: str
    """Why it did not pass, or what was not looked at."""


def run(
    cases: Iterable[Case],
    make_host: Callable[[], Host],
    bench: Mapping[str, Any] | None,
    *,
    moving: bool,
) -> list[Result]:
    """All results in order; each case begins with a conversation of its own, which disarms, and ends disarmed.

    Raises
    ------
    UnreadableError
        No frame came before the first result: no case can be tried.
    """
    results: list[Result] = []
    for case in cases:
        try:
            results.append(_judged(case, make_host, bench, moving))
        except UnreadableError as error:
            if not results:
                raise
            results.append(Result(case, FAIL, str(error)))
    return results


def _judged(case: Case, make_host: Callable[[], Host], bench: Mapping[str, Any] | None, moving: bool) -> Result:
    """A case that fails while this host was late is tried once more, and then not held against the box."""
    for _ in range(2):
        host = make_host()
        result = _one(case, host, bench, moving)
        if result.outcome != FAIL or host.silence <= PUNCTUAL:
            return result
    return Result(case, NOT_JUDGED, f"this host was silent for {1e3 * host.silence:.0f} ms; {result.found}")


def _one(case: Case, host: Host, bench: Mapping[str, Any] | None, moving: bool) -> Result:
    if case.moving and not moving:
        return Result(case, LEFT_OUT, "may move the piston: --moving")
    if case.needs == "bench" and bench is None:
        return Result(case, LEFT_OUT, "needs the box's bench file: --bench")
    checked: list[tuple[Host, dict[str, Any]]] = []
    silent = ""
    try:
        _begin(host)
        if case.needs == "version 2" and host.version < 2:
            return Result(case, LEFT_OUT, "the box speaks version 1")
        for step in case.steps:
            if step.verb == "check":
                checked.append((host.kept(), step.words))
            else:
                _VERBS[step.verb](host, step.words)
        _end(host)
    except SilentError as error:
        silent = str(error)
    return _verdict(case, checked, bench, silent)


def _verdict(
    case: Case, checked: list[tuple[Host, dict[str, Any]]], bench: Mapping[str, Any] | None, silent: str
) -> Result:
    """Judge when the case is over: while this host computes, the box would hear no command."""
    try:
        for host, words in checked:
            for name, parameters in words.items():
                if found := checks.CHECKS[name](host, bench, **(parameters or {})):
                    return Result(case, FAIL, f"{name}: {found}")
    except NotToldError as missing:
        return Result(case, LEFT_OUT, str(missing))
    notes = [note for host, _ in checked for note in host.notes]
    return Result(case, FAIL if silent else PASS, silent or "; ".join(notes))


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
    host.sequence = (host.states[-1].last_command + _APART) % 2**32  # no number of the conversation before
    host.command = Command()
    host.mark()
    host.send()
    host.lag = _until_confirmed(host, host.send)
    host.listen(20, host.send)
    host.command = Command()
    host.forget()


def _until_confirmed(host: Host, each: Callable[[], None] | None = None) -> int:
    """Wait until the step's first command, or one behind it, is confirmed: how many samples later than at once."""
    first = host.sent[host.marked_sent]
    for _ in range(_ANSWER):  # a host that lags reads old samples first, a line may hold bytes
        if (at := host.confirmed(first.sequence)) < len(host.states):
            return at - first.after
        host.listen(1, each)
    return 0


def _end(host: Host) -> None:
    """Leave the box disarmed, whatever the case did."""
    host.command = Command()
    host.listen(10, host.send)


def _commands(host: Host, words: dict[str, Any]) -> None:
    """A command at once and behind every `every`-th sample, `times` of them each, for `samples`."""
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
    _until_confirmed(host, each)
    host.listen(int(words["samples"]), each)


def _once(host: Host, words: dict[str, Any]) -> None:
    """One command; `sequence` counts from the last one that was sent, 0 repeats it."""
    changes = _changes(host, words, "sequence", "samples", "goes_on")
    before, step = host.sequence, int(words.get("sequence", 1))
    host.mark()
    host.send((before + step) % 2**32, **changes)
    samples = int(words.get("samples", 15))
    if step == 1 or words.get("goes_on"):
        _until_confirmed(host)
    else:  # nothing will confirm it: let it arrive
        host.sequence = before
        samples += host.lag
    host.listen(samples)


def _wait(host: Host, words: int) -> None:
    host.listen(int(words))


def _greet(host: Host, words: dict[str, Any]) -> None:
    """Greet as a host of the versions given; what is checked begins behind the answer, if one comes."""
    low, high = words.get("versions", (1, VERSION))
    body = bytearray(cobs.decode(encode_hello(0, int(1e6 * host.clock()))[1:-1])[:-4])
    body[14:16] = bytes((low, high))
    host.mark()
    host.details, host.greeted_at = None, len(host.states)
    host.write(sealed(bytes(body)))
    for _ in range(_ANSWER):
        if host.hellos and host.hellos[-1][0] >= host.greeted_at:
            host.mark()
            host.marked = host.hellos[-1][0]
            break
        host.listen(1)
    host.listen(int(words.get("samples", 50)))


def _garbage(host: Host, words: dict[str, Any]) -> None:
    """Noise in front of a command, for so many samples; none of it is a frame."""
    random = Random(int(words["seed"]))
    host.command = changed(host.command, _changes(host, words, "samples", "seed", "longest"))
    host.mark()

    def each() -> None:
        host.write(random.randbytes(random.randint(1, int(words["longest"]))) + b"\0")
        host.send()

    host.listen(int(words["samples"]), each)
    host.listen(5 + host.lag)


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
    host.listen(10 + host.lag)


def _changes(host: Host, words: dict[str, Any], *others: str) -> dict[str, Any]:
    """The words that change a command; a number may be the name of one that DETAILS tell."""
    changes = {key: value for key, value in words.items() if key not in others}
    for key, value in changes.items():
        if key != "waveform" and isinstance(value, str):
            changes[key] = getattr(host.details.details, value) if host.details else 0.0
    return changes


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
