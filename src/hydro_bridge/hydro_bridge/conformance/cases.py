# SPDX-License-Identifier: Apache-2.0
"""Test cases as data, read from `cases.yaml`; their execution, one conversation each, and their results."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

import yaml

from hydro_bridge.conformance.checks import CHECKS, NotToldError
from hydro_bridge.conformance.host import PUNCTUAL, VERBS, Host, SilentError, UnreadableError, begin, end
from hydro_bridge.errors import UserError


@dataclass(frozen=True)
class Step:
    """One verb with its parameters."""

    verb: str
    words: Any


@dataclass(frozen=True)
class Case:
    """One requirement on a box."""

    id: str
    says: str
    """The requirement, as one sentence."""
    moving: bool
    """Whether the case arms the box, or asks it to arm: the piston may move."""
    needs: str
    """Precondition, `version 2`, `bench`, `compensated law`, or both of these; empty: none."""
    steps: tuple[Step, ...]


def shipped() -> tuple[Case, ...]:
    """Return the cases shipped with this package."""
    text = resources.files("hydro_bridge.conformance").joinpath("cases.yaml").read_text(encoding="utf-8")
    return read(yaml.safe_load(text))


def read(content: Any) -> tuple[Case, ...]:
    """Parse the cases from a file's content.

    Raises
    ------
    UserError
        A case is incomplete, a verb is unknown, or a case that is not marked as moving asks a box to arm.
    """
    cases = tuple(_case(entry) for entry in content)
    ids = [case.id for case in cases]
    if len(set(ids)) < len(ids):
        raise UserError("two conformance cases have the same id")
    return cases


def _case(entry: Mapping[str, Any]) -> Case:
    unknown = set(entry) - {"id", "says", "moving", "needs", "steps"}
    if unknown or not {"id", "says", "steps"} <= set(entry):
        raise UserError(f"conformance case {entry.get('id')!r} needs id, says and steps, and knows moving and needs")
    steps = tuple(_step(str(entry["id"]), step) for step in entry["steps"])
    case = Case(entry["id"], entry["says"], bool(entry.get("moving")), str(entry.get("needs", "")), steps)
    if not case.moving and any(isinstance(step.words, Mapping) and step.words.get("arm") for step in steps):
        raise UserError(f"conformance case {case.id!r} asks the box to arm and is not marked as moving")
    return case


def _step(case: str, step: Any) -> Step:
    if not isinstance(step, Mapping) or len(step) != 1 or next(iter(step)) not in (*VERBS, "check"):
        raise UserError(f"conformance case {case!r}: a step is one of {', '.join(VERBS)}, check, not {step!r}")
    ((verb, words),) = step.items()
    return Step(verb, words)


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
        begin(host)
        if case.needs == "version 2" and host.version < 2:
            return Result(case, LEFT_OUT, "the box speaks version 1")
        if "compensated law" in case.needs and host.law is None:
            return Result(case, LEFT_OUT, "the box runs the paper's law only")
        for step in case.steps:
            if step.verb == "check":
                checked.append((host.kept(), step.words))
            else:
                VERBS[step.verb](host, step.words)
        end(host)
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
                if found := CHECKS[name](host, bench, **(parameters or {})):
                    return Result(case, FAIL, f"{name}: {found}")
    except NotToldError as missing:
        return Result(case, LEFT_OUT, str(missing))
    notes = [note for host, _ in checked for note in host.notes]
    return Result(case, FAIL if silent else PASS, silent or "; ".join(notes))
