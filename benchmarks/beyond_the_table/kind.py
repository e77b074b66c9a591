# SPDX-License-Identifier: Apache-2.0
"""What is known of a kind of physics outside the table: where it lives, how large it is drawn, its right form."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of physics that no effect id names."""

    name: str
    half: str
    """`dev`, which improvements may look at, or `sealed`."""
    equations: tuple[str, ...]
    """Where a report may locate it: ids of `location`."""
    size: tuple[float, float]
    """Range of its magnitude; drawn with either end equally likely, by logarithm."""
    unit: str
    shape: float
    """Its second number (a time, a position, a width), SI."""
    variables: frozenset[str]
    """What a law of the right form depends on, and nothing else."""
    memory: bool = False
    """Whether a law of the right form has a state of its own."""
    degree: float | None = None
    """Total power of the signals in the law, where the form is a monomial; signs and thresholds count nothing."""
    named: str = ""
    """Cause of the table that is this kind after all, as `id form`: found only once `diagnose` had named it."""


def entry(name: str, half: str, equations: str, size: tuple[float, float], unit: str, shape: float, variables: str,
          memory: bool = False, degree: float | None = None, named: str = "") -> Kind:  # fmt: skip
    """A kind in one line: equations and variables in words apart."""
    return Kind(name=name, half=half, equations=tuple(equations.split()), size=size, unit=unit, shape=shape,
                variables=frozenset(variables.split()), memory=memory, degree=degree, named=named)  # fmt: skip


FLOW = "actuation pressure_a pressure_b"
CHAMBERS = "pressure_a pressure_b"
