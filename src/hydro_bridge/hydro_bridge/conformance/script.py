# SPDX-License-Identifier: Apache-2.0
"""Cases as data: what is sent, and what must come. `cases.yaml` is read here, and refused where it makes no sense."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from importlib import resources
from typing import Any

import yaml

from hydro_bridge.errors import UserError

VERBS = ("commands", "once", "wait", "greet", "garbage", "damaged", "check")
"""What a step can be."""


@dataclass(frozen=True)
class Step:
    """One verb with its words."""

    verb: str
    words: Any


@dataclass(frozen=True)
class Case:
    """One thing that a box must do."""

    id: str
    says: str
    """What must hold, as one sentence."""
    moving: bool
    """Whether it arms, or asks a box to arm: the piston may move."""
    needs: str
    """`bench` or `version 2`; empty: nothing."""
    steps: tuple[Step, ...]


def shipped() -> tuple[Case, ...]:
    """The cases that come with this package."""
    text = resources.files("hydro_bridge.conformance").joinpath("cases.yaml").read_text(encoding="utf-8")
    return read(yaml.safe_load(text))


def read(content: Any) -> tuple[Case, ...]:
    """Cases of a file's content.

    Raises
    ------
    UserError
        A case is not complete, a verb is unknown, or a case that is not marked as moving asks a box to arm.
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
