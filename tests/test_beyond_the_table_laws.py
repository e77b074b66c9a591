# SPDX-License-Identifier: Apache-2.0
"""Each sealed kind of unnamed physics follows the law it says: found again in a run's log, by finite differences.

The equations are those of physics.md, the laws a second derivation: from the log alone, without the plant's code.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest

from benchmarks.beyond_the_table import plant
from benchmarks.beyond_the_table.kinds import KINDS, NAMES, Kind
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.recordings import reference

FloatArray = npt.NDArray[np.float64]
BENCH, PERIOD, ROWS = numbers(), 1e-3, 3000
QUIET = 300
"""Rows at either end in which the loop starts, or differences have an edge."""
GAIN = BENCH.valve_nominal_flow / BENCH.valve_nominal_current / math.sqrt(BENCH.valve_nominal_pressure_drop / 2.0)
AREA_B, REST = BENCH.area_ratio * BENCH.piston_area, BENCH.spring_rest_position
CORNER = 2.0 * math.pi * BENCH.load_cell_bandwidth
SEALED = [kind for kind in KINDS if kind.half == "sealed"]


def logged(kind: Kind | None) -> FloatArray:
    """Run without noise and encoder's step, shape (ROWS, LOGGED)."""
    place, size, shape = (-1, 0.0, 1.0) if kind is None else (NAMES.index(kind.name), kind.size[1], kind.shape)
    wanted = reference("sines", ROWS, 3)
    return plant.run(BENCH, place, size, shape, wanted, gain=80.0, noise=np.zeros((ROWS, 4)), quantum=0.0)


def middle(signal: FloatArray) -> FloatArray:
    """Values halfway between rows."""
    return np.asarray(0.5 * (signal[1:] + signal[:-1]))


def residuals(log: FloatArray) -> dict[str, FloatArray]:
    """What physics.md leaves unexplained in each equation: N, m3/s, N, N; at rows, in the chambers halfway between."""
    hydraulic, cell, a, b, position, current = log[:, [0, 2, 4, 5, 6, 8]].T
    velocity = np.gradient(position, PERIOD)
    load = cell + math.sqrt(2.0) / CORNER * np.gradient(cell, PERIOD) + second(cell) / CORNER**2
    between, out, moved = current[:-1], current[:-1] >= 0.0, np.diff(position) / PERIOD
    into_a = GAIN * between * np.sqrt(np.where(out, BENCH.supply_pressure - middle(a), middle(a)))
    out_of_b = GAIN * between * np.sqrt(np.where(out, middle(b), BENCH.supply_pressure - middle(b)))
    volume_a = BENCH.dead_volume_a + BENCH.piston_area * middle(position)
    volume_b = BENCH.dead_volume_b + AREA_B * (BENCH.stroke - middle(position))
    return {
        "motion": hydraulic - BENCH.viscous_friction * velocity - load - BENCH.moving_mass * second(position),
        "load": load - BENCH.spring_stiffness * (position - BENCH.spring_rest_position),
        "pressure_a": volume_a / BENCH.bulk_modulus * np.diff(a) / PERIOD - into_a + BENCH.piston_area * moved,
        "pressure_b": volume_b / BENCH.bulk_modulus * np.diff(b) / PERIOD + out_of_b - AREA_B * moved,
        "sensor": hydraulic - BENCH.piston_area * a + AREA_B * b,
    }


def second(signal: FloatArray) -> FloatArray:
    """Second derivative."""
    return np.concatenate([[0.0], np.diff(signal, 2), [0.0]]) / PERIOD**2


class Signals(NamedTuple):
    """Of a run, shape (ROWS,) each; (ROWS - 1,) halfway between rows, where the current is the earlier row's."""

    a: FloatArray
    b: FloatArray
    x: FloatArray
    v: FloatArray
    u: FloatArray
    """In both cases the current that acts there."""


def signals(log: FloatArray, *, halfway: bool) -> Signals:
    hydraulic, a, position, current = log[:, [0, 4, 6, 8]].T
    b = (BENCH.piston_area * a - hydraulic) / AREA_B if not halfway else log[:, 5]
    if halfway:
        return Signals(middle(a), middle(b), middle(position), np.diff(position) / PERIOD, current[:-1])
    acting = np.concatenate([[0.0], current[:-1]])
    return Signals(a, b, position, np.gradient(position, PERIOD), acting)


def lag(signal: FloatArray, seconds: float) -> FloatArray:
    """First-order lag from rest, exact for a signal that is held from row to row."""
    out, share = np.zeros_like(signal), 1.0 - math.exp(-PERIOD / seconds)
    for k in range(1, len(signal)):
        out[k] = out[k - 1] + share * (signal[k - 1] - out[k - 1])
    return out


def warmth(s: Signals, seconds: float) -> FloatArray:
    return lag(np.abs(s.u) / BENCH.valve_nominal_current, seconds)


def bump(position: FloatArray, place: float, width: float) -> FloatArray:
    return np.asarray(np.exp(-(((position - place) / width) ** 2)))


def over_a(s: Signals) -> FloatArray:
    """Flow into A by current [m3/s/A]."""
    return np.asarray(GAIN * np.sqrt(np.where(s.u >= 0.0, BENCH.supply_pressure - s.a, s.a)))


def kept_back(s: Signals, resistance: float) -> FloatArray:
    """Flow out of B that a filter behind the valve keeps back, by bisection of q = g u sqrt(p_b - R q^2)."""
    opened = GAIN * np.maximum(s.u, 0.0)
    wide = opened * np.sqrt(s.b)
    low, high = np.zeros_like(wide), wide
    for _ in range(50):
        flow = 0.5 * (low + high)
        short = flow < opened * np.sqrt(np.maximum(s.b - resistance * flow**2, 0.0))
        low, high = np.where(short, flow, low), np.where(short, high, flow)
    return np.asarray(np.where(s.u > 0.0, wide - low, 0.0))


def throttled(pressure: FloatArray, falling: float) -> FloatArray:
    """Pressure behind a check valve with a throttle beside it, that opens at once."""
    out = pressure.copy()
    for k in range(1, len(out)):
        out[k] = max(out[k], out[k] + (out[k - 1] - out[k]) * math.exp(-PERIOD / falling))
    return out


EXPECTED: dict[str, tuple[str, Callable[[Signals, float, float], FloatArray]]] = {
    "friction_lag": ("motion", lambda s, c, h: c * np.exp(-((lag(s.v, h) / 0.05) ** 2)) * np.tanh(s.v / 2e-3)),
    "bore_score": ("motion", lambda s, c, h: c * bump(s.x, 0.043, h) * np.tanh(s.v / 2e-3)),
    "shear_thinning": ("motion", lambda s, c, h: c * h * s.v / (h + np.abs(s.v))),
    "port_relief": ("pressure_a", lambda s, c, h: -c * np.clip(s.a - h, 0.0, None)),
    "worn_bore": ("pressure_b", lambda s, c, h: c * (s.a - s.b) * bump(s.x, 0.045, h)),
    "hot_leak": ("pressure_a", lambda s, c, h: -c * (s.a - s.b) * warmth(s, h)),
    "rod_film": ("pressure_b", lambda s, c, h: -c * AREA_B * s.v * (s.v > 0.0)),
    "spool_stop": ("pressure_a", lambda s, c, h: -c * np.clip(s.u - h, 0.0, None) * over_a(s)),
    "null_warms": ("pressure_a", lambda s, c, h: c * warmth(s, h) * over_a(s)),
    "return_filter": ("pressure_b", lambda s, c, h: kept_back(s, c)),
    "stop_spring": ("load", lambda s, c, h: c * (s.x - h) * (s.x > h)),
    "rebound_damper": ("load", lambda s, c, h: c * s.v**2 * (s.v > 0.0)),
    "leaf_spring": ("load", lambda s, c, h: c * BENCH.spring_stiffness * np.abs(s.x - REST) * np.tanh(s.v / h)),
    "cell_pickup": ("sensor", lambda s, c, h: c * s.u),
    "gauge_warms": ("sensor", lambda s, c, h: AREA_B * c * -np.expm1(-PERIOD * np.arange(ROWS) / h)),
    "gauge_snubber": ("sensor", lambda s, c, h: AREA_B * (throttled(s.b, c) - s.b)),
}
"""Equation, and what it must leave unexplained, by signals, size and shape: a second derivation, from the log alone."""


@pytest.mark.parametrize("kind", SEALED, ids=[kind.name for kind in SEALED])
def test_a_sealed_kind_follows_the_law_it_says(kind: Kind) -> None:
    """Its residual is the law's, number and all; and no equation but its own leaves more than on a clean bench."""
    log, clean = logged(kind), residuals(logged(None))
    equation, law = EXPECTED[kind.name]
    found, left = residuals(log), law(signals(log, halfway=equation.startswith("pressure")), kind.size[1], kind.shape)
    miss = (found[equation] - left)[QUIET:-QUIET]
    residual, left = found[equation][QUIET:-QUIET], left[QUIET:-QUIET]
    assert residual @ left / (left @ left) == pytest.approx(1.0, abs=0.03)
    assert np.std(miss) < 0.08 * np.sqrt(np.mean(left**2))
    if equation == "sensor":
        return  # that reading stands in other equations; the rates do not know it (test_beyond_the_table_physics.py)
    for other in found.keys() - set(kind.equations):
        assert np.std(found[other][QUIET:-QUIET]) < 2.5 * np.std(clean[other][QUIET:-QUIET]), other
