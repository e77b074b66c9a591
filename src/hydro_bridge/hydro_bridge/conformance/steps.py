# SPDX-License-Identifier: Apache-2.0
"""Transmission of a step, by its verb: commands, a single command, silence, a greeting, garbage, a damaged frame."""

from __future__ import annotations

from collections.abc import Callable
from random import Random
from typing import Any

from cobs import cobs

from hydro_bridge.conformance import damage
from hydro_bridge.conformance.conversation import ANSWER, until_confirmed
from hydro_bridge.conformance.host import Host, changed
from hydro_bridge.serial.protocol import VERSION, encode_command, encode_hello
from hydro_bridge.signals import Command


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
    host.write(damage.sealed(bytes(body)))
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
    host.write(damage.damaged(frame, str(words["how"])))
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
