# SPDX-License-Identifier: Apache-2.0
"""Execution of the cases, one conversation each, and their results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from hydro_bridge.conformance import checks, conversation
from hydro_bridge.conformance.host import PUNCTUAL, Host, SilentError, UnreadableError
from hydro_bridge.conformance.readings import NotToldError
from hydro_bridge.conformance.script import Case
from hydro_bridge.conformance.steps import VERBS

PASS, FAIL, LEFT_OUT, NOT_JUDGED = "pass", "FAIL", "left out", "not judged"


@dataclass(frozen=True)
class Result:
    """Result of a case."""

    case: Case
    outcome: str
    """`PASS`, `FAIL`, `LEFT_OUT` or `NOT_JUDGED`."""
    found: str
    """Reason why it did not pass, or what was not examined."""


def run(
    cases: Iterable[Case],
    make_host: Callable[[], Host],
    bench: Mapping[str, Any] | None,
    *,
    moving: bool,
) -> list[Result]:
    """Return all results in order; each case opens its own conversation, which disarms, and ends disarmed.

    Raises
    ------
    UnreadableError
        No frame arrived before the first result: no case can be run.
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
    """Run a case; a failure while this host was late is repeated once, and then not held against the box."""
    for _ in range(2):
        host = make_host()
        result = _one(case, host, bench, moving)
        if result.outcome != FAIL or host.silence <= PUNCTUAL:
            return result
    return Result(case, NOT_JUDGED, f"this host was silent for {1e3 * host.silence:.0f} ms; {result.found}")


def _one(case: Case, host: Host, bench: Mapping[str, Any] | None, moving: bool) -> Result:
    if case.moving and not moving:
        return Result(case, LEFT_OUT, "may move the piston: --moving")
    if "bench" in case.needs and bench is None:
        return Result(case, LEFT_OUT, "needs the box's bench file: --bench")
    checked: list[tuple[Host, dict[str, Any]]] = []
    silent = ""
    try:
        conversation.begin(host)
        if case.needs == "version 2" and host.version < 2:
            return Result(case, LEFT_OUT, "the box speaks version 1")
        if "compensated law" in case.needs and host.law is None:
            return Result(case, LEFT_OUT, "the box runs the paper's law only")
        for step in case.steps:
            if step.verb == "check":
                checked.append((host.kept(), step.words))
            else:
                VERBS[step.verb](host, step.words)
        conversation.end(host)
    except SilentError as error:
        silent = str(error)
    return _verdict(case, checked, bench, silent)


def _verdict(
    case: Case, checked: list[tuple[Host, dict[str, Any]]], bench: Mapping[str, Any] | None, silent: str
) -> Result:
    """Evaluate after the end of the case: while this host computes, the box would receive no command."""
    try:
        for host, words in checked:
            for name, parameters in words.items():
                if found := checks.CHECKS[name](host, bench, **(parameters or {})):
                    return Result(case, FAIL, f"{name}: {found}")
    except NotToldError as missing:
        return Result(case, LEFT_OUT, str(missing))
    notes = [note for host, _ in checked for note in host.notes]
    return Result(case, FAIL if silent else PASS, silent or "; ".join(notes))
