# SPDX-License-Identifier: Apache-2.0
"""Modulations that are a signal: a carrier that grows with another quantity; and what repeats along the stroke."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from hydro_sim.model.equations import Symbol
from hydro_sim.model.grammar.parts import Modulation
from hydro_sim.model.grammar.words import BETWEEN, deflection, middle
from hydro_sim.model.law_signals import Signals
from hydro_sim.model.laws import Number


def _times(text: str, unit: str, scale: float, uses: str, cause: str,
           factor: Callable[[Signals, Any], Symbol]) -> Modulation:  # fmt: skip
    return Modulation(name=f"times {text}", text=f"{{}} {text}", unit=unit, scale=scale, uses=uses, degree=1.0,
                      phrase=f", in proportion to {cause}", factor=factor)  # fmt: skip


BY_BEND = _times("|x - x_rest|", "m", 1e-2, "position", "the load's deflection: typical of parts that it tilts",
                 lambda at, n: np.abs(deflection(at, n)))  # fmt: skip
BY_STROKE = _times("(x/L - 1/2)", "-", 0.3, "position", "the place on the stroke: typical of a gap that widens",
                   middle)  # fmt: skip
BY_PLACE = _times("(x - x_rest)", "m", 1e-2, "position", "the load's deflection: typical of a body that is bent along",
                  deflection)  # fmt: skip
BY_P_A = _times("p_a", "Pa", 5e6, "pressure_a", "the pressure of chamber A: typical of parts that it presses on",
                lambda at, n: at.pressure_a)  # fmt: skip
BY_P_B = _times("p_b", "Pa", 5e6, "pressure_b", "the pressure of chamber B: typical of parts that it presses on",
                lambda at, n: at.pressure_b)  # fmt: skip
BY_ACROSS = _times("|p_a - p_b|", "Pa", 3e6, BETWEEN, "the pressure across the piston: typical of parts under it",
                   lambda at, n: at.size_of_difference)  # fmt: skip
BY_SPEED = _times("|v|", "m/s", 0.05, "velocity", "the speed: typical of a gap or a lip that motion opens",
                  lambda at, n: at.speed)  # fmt: skip
BY_OPENING = _times("|u|", "A", 2e-3, "current", "the valve's opening: typical of parts that share its flow or supply",
                    lambda at, n: at.opening)  # fmt: skip
BY_CURRENT = _times("u", "A", 2e-3, "current", "the valve's current: typical of a shared ground",
                    lambda at, n: at.current)  # fmt: skip

_PITCHES = tuple(round(1.0 / (62.5 + 31.25 * k), 6) for k in range(-1, 15))
"""Start values [m] of a pitch, 32 mm to 2 mm: apart by as much as a range of 3 cm tells."""
_PHASE = Number("phase", "-", (np.pi, 1.5 * np.pi))


def _repeats(pitches: tuple[float, ...]) -> tuple[Number, Number]:
    return Number("pitch", "m", tuple(sorted(pitches))), _PHASE


RIPPLE = Modulation(
    name="in ripples", text="{} sin(2 pi x / pitch + phase)", uses="position",
    phrase=", again and again along the stroke: typical of a scale, a thread or a tooth",
    factor=lambda at, n: np.sin(2.0 * np.pi * at.position / at.number + at.second),
    numbers=_repeats(_PITCHES),
)  # fmt: skip
WAVES = Modulation(
    name="in waves", text="{} (1 + sin(2 pi x / pitch + phase)) / 2", uses="position",
    phrase=", again and again along the stroke, between nothing and all: typical of a bore that a hone has left in "
    "waves",
    factor=lambda at, n: 0.5 + 0.5 * np.sin(2.0 * np.pi * at.position / at.number + at.second),
    numbers=_repeats(_PITCHES[1:]),  # a wave of the range is a trend, which other laws have
)  # fmt: skip
