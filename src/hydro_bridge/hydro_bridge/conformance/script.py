# SPDX-License-Identifier: Apache-2.0
"""Test cases as data: commands sent and answers expected. Reads `cases.yaml` and rejects invalid content."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

import yaml

from hydro_bridge.errors import UserError

VERBS = ("commands", "once", "wait", "greet", "garbage", "damaged", "check")
"""Kinds of steps."""


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
    if not isinstance(step, Mapping) or len(step) != 1 or next(iter(step)) not in VERBS:
        raise UserError(f"conformance case {case!r}: a step is one of {', '.join(VERBS)}, not {step!r}")
    ((verb, words),) = step.items()
    return Step(verb, words)
