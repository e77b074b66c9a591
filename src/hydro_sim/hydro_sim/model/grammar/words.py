# SPDX-License-Identifier: Apache-2.0
"""Words that the laws of the grammar are made of: signs, gates, thresholds, memories."""

from __future__ import annotations

from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Element, Number

BETWEEN = "pressure_a pressure_b"
"""What the pressure difference is made of."""


def outwards(direction: Symbol) -> Symbol:
    """1 while the piston moves out, else 0; of the negative direction: while it moves in."""
    return np.fmax(direction, 0.0)


def above(signal: Symbol, threshold: Symbol) -> Symbol:
    """By how much a signal is above a threshold."""
    return np.fmax(signal - threshold, 0.0)


def within(signal: Symbol, threshold: Symbol) -> Symbol:
    """A signal, held where it is further from 0 than a threshold."""
    return np.fmax(np.fmin(signal, threshold), -threshold)


def middle(at: Signals, n: Any) -> Symbol:
    """Position from the middle of the stroke, in strokes."""
    return at.position / n.stroke - 0.5


def deflection(at: Signals, n: Any) -> Symbol:
    """Position from the spring's rest [m]."""
    return at.position - n.spring_rest_position


def threshold(over: str, unit: str, *probes: float) -> tuple[Number, ...]:
    """Where a law begins; `probes` stand for quantiles of a recording."""
    return (Number("threshold", unit, probes, over),)


PLACE = threshold("position", "m", 0.024, 0.034, 0.04, 0.046, 0.056)
LAG = (Number("time", "s", (0.03, 0.1, 0.3, 1.0, 3.0)),)


def creep(signal: str) -> Element:
    """A state that follows a signal over a time (`LAG`)."""
    return Element("lag", signal)


def path(unit: str, *probes: float) -> tuple[Number, ...]:
    """The path over which a hysteresis turns."""
    return (Number("path", unit, probes),)
