# SPDX-License-Identifier: Apache-2.0
"""Kinds of unnamed physics follow the laws they say: each is found again in a run's log, by finite differences.

The equations are those of physics.md: a second derivation, from the log alone, without the plant's code.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import NamedTuple

import numpy as np
import numpy.typing as npt
import pytest
from scipy.signal import lfilter

from benchmarks.beyond_the_table.cases import SUBSTEPS
from benchmarks.beyond_the_table.kinds import KINDS, NAMES, Kind
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.plant import NONE, run
from benchmarks.foreign_truth.recordings import reference

pytestmark = pytest.mark.study
FloatArray = npt.NDArray[np.float64]
BENCH, PERIOD, ROWS = numbers(), 1e-3, 3000
START = 6e6
"""Pa, of chamber A."""
QUIET = 300
"""Rows at either end in which the loop starts, or differences have an edge."""
GAIN = BENCH.valve_nominal_flow / BENCH.valve_nominal_current / math.sqrt(BENCH.valve_nominal_pressure_drop / 2.0)
AREA_B, REST = BENCH.area_ratio * BENCH.piston_area, BENCH.spring_rest_position
CORNER = 2.0 * math.pi * BENCH.load_cell_bandwidth


def logged(kind: Kind | None) -> FloatArray:
    """Run without noise and encoder's step, shape (ROWS, LOGGED)."""
    physics = NONE if kind is None else (NAMES.index(kind.name), kind.size[1], kind.shape)
    return run(BENCH, reference("sines", ROWS, 3), substeps=SUBSTEPS, physics=physics)


def middle(signal: FloatArray) -> FloatArray:
    """Values halfway between rows."""
    return np.asarray(0.5 * (signal[1:] + signal[:-1]))


def residuals(log: FloatArray) -> dict[str, FloatArray]:
    """What physics.md leaves unexplained in each equation, N and m3/s: at rows, in the chambers halfway between.

    `sensor` and `cell` are what the hydraulic cell and the load's cell read beyond the pressures and the spring.
    """
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
        "cell": cell - seen(position),
    }


def seen(position: FloatArray) -> FloatArray:
    """What a load's cell would read [N]: the spring's force behind the amplifier, bilinear from row to row."""
    force, grown = BENCH.spring_stiffness * (position - REST), 2.0 / PERIOD / CORNER
    ahead = [1.0 + math.sqrt(2.0) * grown + grown**2, 2.0 - 2.0 * grown**2, 1.0 - math.sqrt(2.0) * grown + grown**2]
    return np.asarray(lfilter([1.0, 2.0, 1.0], ahead, force))


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
    f: FloatArray
    """Hydraulic force, as the gauges have it."""


def signals(log: FloatArray, *, halfway: bool) -> Signals:
    hydraulic, a, position, current = log[:, [0, 4, 6, 8]].T
    b = (BENCH.piston_area * a - hydraulic) / AREA_B if not halfway else log[:, 5]
    force = BENCH.piston_area * a - AREA_B * log[:, 5]
    if halfway:
        return Signals(middle(a), middle(b), middle(position), np.diff(position) / PERIOD, current[:-1], middle(force))
    acting = np.concatenate([[0.0], current[:-1]])
    return Signals(a, b, position, np.gradient(position, PERIOD), acting, force)


def followed(signal: FloatArray, start: float, rate: Callable[[float, float], float], substeps: int = 20) -> FloatArray:
    """What follows a signal at a rate of signal and state, the signal taken as straight from row to row."""
    out = np.full_like(signal, start)
    for k in range(1, len(signal)):
        out[k] = out[k - 1]
        for j in range(substeps):
            between = signal[k - 1] + (j + 0.5) / substeps * (signal[k] - signal[k - 1])
            out[k] += PERIOD / substeps * rate(between, out[k])
    return out


def signed_root(difference: FloatArray) -> FloatArray:
    return np.asarray(np.sign(difference) * np.sqrt(np.abs(difference)))


def bump(position: FloatArray, place: float, width: float) -> FloatArray:
    return np.asarray(np.exp(-(((position - place) / width) ** 2)))


def over_a(s: Signals) -> FloatArray:
    """Flow into A by current [m3/s/A]."""
    return np.asarray(GAIN * np.sqrt(np.where(s.u >= 0.0, BENCH.supply_pressure - s.a, s.a)))


def passed(s: Signals, spool: FloatArray) -> FloatArray:
    """Flow into A [m3/s] over a spool [A], beyond that over the current."""
    return np.asarray(over_a(s._replace(u=spool)) * spool - over_a(s) * s.u)


def strained(pressure: FloatArray, seconds: float) -> FloatArray:
    """By how much [Pa] a pressure is above what a lip has flowed to."""
    return np.asarray(pressure - followed(pressure, pressure[0], lambda p, w: (p - w) / seconds))


def pocketed(pressure: FloatArray, filling: float, emptying: float) -> FloatArray:
    """Rate [Pa/s] of the pressure in a pocket that fills fast and empties slowly."""

    def rate(p: float, w: float) -> float:
        return (p - w) / (filling if p > w else emptying)

    inside = followed(pressure, pressure[0], rate)
    return np.array([rate(p, w) for p, w in zip(pressure, inside, strict=True)])


def dragged(current: FloatArray, half: float, seconds: float) -> FloatArray:
    """Mean from row to row of what a held current drags along that has this play [A] either way, within a time."""
    out, now = np.zeros_like(current), 0.0
    for k, drawn in enumerate(current):
        there = min(max(now, drawn - half), drawn + half)
        out[k] = there + (now - there) * seconds / PERIOD
        now = there
    return out


def hunted(s: Signals, size: float, frequency: float) -> FloatArray:
    """Flow into A [m3/s] that a supply gives whose pressure swings about its own, halfway between rows."""
    swung = size * np.sin(2.0 * np.pi * frequency * PERIOD * (np.arange(len(s.a)) + 0.5))
    above = BENCH.supply_pressure - s.a
    return np.asarray(GAIN * np.maximum(s.u, 0.0) * (np.sqrt(above + swung) - np.sqrt(above)))


def followed_with_play(current: FloatArray, width: float) -> FloatArray:
    """What follows a current behind play, from the middle of it."""
    out, before = np.zeros_like(current), 0.0
    for k, held_current in enumerate(current):
        away = before - held_current
        before = held_current + math.copysign(min(abs(away), 0.5 * width), away)
        out[k] = before
    return out


EXPECTED: dict[str, tuple[str, Callable[[Signals, float, float], FloatArray]]] = {
    "rod_seal_pressure_friction": ("motion", lambda s, c, h: c * s.b * np.tanh(s.v / h)),
    "side_load_friction": (
        "motion",
        lambda s, c, h: c * BENCH.spring_stiffness * np.abs(s.x - REST) * np.tanh(s.v / h),
    ),
    "tight_spot_friction": ("motion", lambda s, c, h: c * bump(s.x, h, 2e-3) * np.tanh(s.v / 3e-3)),
    "turbulent_drag": ("motion", lambda s, c, h: c * np.sign(s.v) * s.v**2),
    "relief_cracking_b": ("pressure_b", lambda s, c, h: -c * np.clip(s.b - h, 0.0, None)),
    "scored_bore_leakage": ("pressure_a", lambda s, c, h: -c * (s.a - s.b) * (s.x > h)),
    "hose_creep_a": ("pressure_a", lambda s, c, h: -c * strained(s.a, h) / h),
    "rod_seal_weep_extending": ("pressure_b", lambda s, c, h: -c * s.b * np.clip(np.tanh(s.v / 1e-3), 0.0, None)),
    "valve_hysteresis_play": ("pressure_a", lambda s, c, h: passed(s, dragged(s.u, c, 2e-5))),
    "null_shift_load_pressure": ("pressure_a", lambda s, c, h: passed(s, s.u - c * (s.a - s.b))),
    "supply_hunting": ("pressure_a", lambda s, c, h: hunted(s, c, h)),
    "spring_guide_friction": ("load", lambda s, c, h: c * np.tanh(s.v / h)),
    "carriage_inertia_at_cell": ("load", lambda s, c, h: c * second(s.x)),
    "coil_contact": ("load", lambda s, c, h: c * np.clip(s.x - h, 0.0, None)),
    "encoder_mount_flex": (
        "load",
        lambda s, c, h: BENCH.spring_stiffness * (s.x - REST) * (1.0 / (1.0 + c * BENCH.spring_stiffness) - 1.0),
    ),
    "load_cell_warm_up": ("cell", lambda s, c, h: c * -np.expm1(-PERIOD * np.arange(ROWS) / h)),
    "seal_film_drag": ("motion", lambda s, c, h: c * signed_root(s.v)),
    "piston_lip_friction": ("motion", lambda s, c, h: c * np.abs(s.a - s.b) * np.tanh(s.v / 5e-3)),
    "askew_load_friction": (
        "motion",
        lambda s, c, h: c * BENCH.spring_stiffness * np.abs(s.x - REST) * np.tanh(s.v / 5e-3),
    ),
    "cable_loop_spring": ("motion", lambda s, c, h: c * (s.x - h)),
    "rod_seal_scratch": ("pressure_b", lambda s, c, h: -c * np.sqrt(s.b)),
    "hose_wall_creep": ("pressure_a", lambda s, c, h: -c * pocketed(s.a, h, h)),
    "bore_worn_mid": ("pressure_b", lambda s, c, h: c * (s.a - s.b) * bump(s.x, 0.04, h)),
    "relief_weeps_a": ("pressure_a", lambda s, c, h: -c * (s.a - h) * (s.a > h)),
    "flow_curve_bends": ("pressure_a", lambda s, c, h: passed(s, s.u / (1.0 + c * np.abs(s.u)))),
    "torque_motor_play": ("pressure_a", lambda s, c, h: passed(s, followed_with_play(s.u, c))),
    "null_warms_up": (
        "pressure_a",
        lambda s, c, h: passed(s, s.u - c * np.expm1(-PERIOD * (np.arange(ROWS - 1) + 0.5) / h)),
    ),
    "coils_touch": ("load", lambda s, c, h: c * np.clip(s.x - h, 0.0, None)),
    "spring_plate_mass": ("load", lambda s, c, h: c * second(s.x)),
    "spring_rubs_guide": ("load", lambda s, c, h: c * np.abs(s.x - REST) * np.tanh(s.v / h)),
    "load_cell_bow": ("cell", lambda s, c, h: c * seen(s.x) ** 2),
    "gauge_span_b": ("sensor", lambda s, c, h: AREA_B * c * s.b),
}
"""Equation, and what it must leave unexplained, by signals, size and shape: a second derivation, from the log alone."""


def test_every_kind_has_its_law_here() -> None:
    assert {kind.name for kind in KINDS} == EXPECTED.keys()


def test_a_kind_follows_the_law_it_says(each: Callable[..., None]) -> None:
    """Its residual is the law's, number and all; and no equation but its own leaves more than on a clean bench."""
    each(KINDS, follows_its_law, lambda kind: kind.name)


def follows_its_law(kind: Kind) -> None:
    log, clean = logged(kind), residuals(logged(None))
    equation, law = EXPECTED[kind.name]
    found, left = residuals(log), law(signals(log, halfway=equation.startswith("pressure")), kind.size[1], kind.shape)
    miss = (found[equation] - left)[QUIET:-QUIET]
    residual, left = found[equation][QUIET:-QUIET], left[QUIET:-QUIET]
    assert residual @ left / (left @ left) == pytest.approx(1.0, abs=0.03)
    assert np.std(miss) < 0.08 * np.sqrt(np.mean(left**2))
    if kind.equations == ("sensor",):
        return  # that reading stands in other equations
    for other in found.keys() - {*kind.equations, "cell"}:
        assert np.std(found[other][QUIET:-QUIET]) < 2.5 * np.std(clean[other][QUIET:-QUIET]), other
