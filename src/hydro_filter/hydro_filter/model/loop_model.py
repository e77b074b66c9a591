# SPDX-License-Identifier: Apache-2.0
"""Force loop of the learned certificate: eight coordinates, and their linearization over one sample.

The paper's x holds states that the force loop does not move (the sum of the pressures) and lacks states that make high
gains unstable (the spool, the velocity as the box differentiates it). The loop's own coordinates are::

    q = [ f_h    g spool   g spool'   f_l    f_l'   x_p   x_p'   x_p' as the box has it ]        8, `LOOP_FIELDS`
          N      N/s       N/s^2      N      N/s    m     m/s    m/s

f_l and f_l' are what the load cell shows, behind its amplifier. The spool counts by the force rate g(x) that it drives:
the law divides by g, and so the loop is nearly the same everywhere. One sample of 1 ms, in units of `scale`::

    q_{k+1} = F q_k + G u_k        F, G: exact, of the full learned state; a nudge of f_h is spread over the pressures
    u_k     = K q_k                as the chambers' stiffnesses do         K: exact, of the force law that the box runs

Dry friction is a bounded disturbance, no part of the loop, and is left out of F (safety.md). K is taken on the
side of zero on which the spool stands, as F is: the two part for the few milliseconds in which the spool follows a
current through zero.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter.model import force_law, structured_kernels
from hydro_filter.model.hidden_states import SPOOL
from hydro_filter.model.state import FORCE_SCALE, LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATES, VELOCITY
from hydro_filter.model.tangent import SOURCES, WIDTH
from hydro_sim import copies
from hydro_sim.box.box import BoxConfig
from hydro_sim.jit import njit
from hydro_sim.model.bench import Bench
from hydro_sim.model.compiled_equations import equations as eq
from hydro_sim.structured import physics
from hydro_sim.structured.model import StructuredModel
from hydro_sim.structured.physics import (
    AREA,
    BRISTLE,
    BRISTLE_DAMPING,
    GAIN_H,
    GAIN_L,
    OFFSET,
    RATIO,
    SUPPLY,
)  # fmt: skip
from hydro_sim.structured.rollout import FULL

LOOP_FIELDS = ("f_h", "spool", "spool_rate", "f_l", "f_l_rate", "x_p", "x_p_rate", "x_p_rate_box")
LOOP = len(LOOP_FIELDS)
Q_HYDRAULIC, Q_SPOOL, Q_SPOOL_RATE, Q_LOAD, Q_LOAD_RATE, Q_POSITION, Q_VELOCITY, Q_BOX_VELOCITY = range(LOOP)

INPUT = Q_BOX_VELOCITY
"""Column of nudges that is the current's: the box's memory of the velocity moves nothing, and needs none."""
CURRENT = SOURCES - 1
"""The current's row of nudges (`tangent`)."""

CLOSED = 1e-9
"""A: where the spool is taken to stand, still, in a sample in which it passes zero.

g differs on both sides, and a sample with a part of each has the derivatives of neither: it is linearized on the side
that the spool comes from.
"""

LOOP_RATE = 130.0
"""rad/s: sqrt(k_s / m) of the nominal bench; force rates and speeds are scaled with it."""


class LoopModel(NamedTuple):
    """The learned model and the box in the form of compiled code; created by `loop_model`."""

    model: tuple[Any, ...]
    """`StructuredModel.compiled`."""
    free: tuple[Any, ...]
    """The same without dry friction: what is linearized."""
    bench: npt.NDArray[np.void]
    """What the box's force law believes, shape (1,)."""
    gain_floor: float
    """N/s/A, smallest g that the force law believes."""
    current_max: float
    """A."""
    scale: FloatArray
    """What q is divided by, shape (8,)."""


class LoopStep(NamedTuple):
    """One sample of the loop, linearized, in units of `scale`, and scratch; created by `loop_step`."""

    transition: FloatArray
    """F, shape (8, 8)."""
    push: FloatArray
    """G [1/A], shape (8,)."""
    feedback: FloatArray
    """K [A], shape (8,)."""
    state_rate: FloatArray
    """x' along the model's own motion [SI units per s], shape (8,)."""
    full: FloatArray
    after: FloatArray
    nudges: FloatArray
    rates: FloatArray
    law: FloatArray


def loop_scale(bench: Bench) -> FloatArray:
    """Scales of the coordinates, shape (8,): 300 N, moving at `LOOP_RATE`, and the drive that this takes."""
    position, rate = FORCE_SCALE / bench.spring_stiffness, FORCE_SCALE * LOOP_RATE
    speed, drive = position * LOOP_RATE, 20.0 * rate  # the oil is some 18 times as stiff as the spring
    return np.array([FORCE_SCALE, drive, 500.0 * drive, FORCE_SCALE, rate, position, speed, speed])


def loop_model(model: StructuredModel, bench: Bench, box: BoxConfig | None = None) -> LoopModel:
    """Return the loop of a learned model under a box configured for `bench`."""
    c, *others = model.compiled
    smooth = c.copy()
    smooth[BRISTLE] = smooth[BRISTLE_DAMPING] = 0.0
    floor = float((box or BoxConfig()).constants(bench)["gain_floor"][0])
    return LoopModel(
        model.compiled, (smooth, *others), bench.constants(), floor, bench.valve_current_max, loop_scale(bench)
    )


def loop_step() -> LoopStep:
    """Allocate the workspace of one caller."""
    shapes = ((LOOP, LOOP), LOOP, LOOP, STATES, FULL, FULL, (SOURCES, WIDTH), (3, WIDTH), STATES)
    return LoopStep(*(np.zeros(shape) for shape in shapes))


@njit
def shares(c, position):
    """Return the changes of p_a and p_b [Pa] for a change of f_h by 1 N, apportioned by the chambers' stiffnesses."""
    by_a, by_b = eq.pressure_rates(physics.numbers(c), physics.stiffnesses(c, position), (0.0, 0.0), 1.0)
    total = c[GAIN_H] * eq.hydraulic_force(physics.numbers(c), by_a, by_b)
    return by_a / total, by_b / total


@njit
def hydraulic_slopes(c, pressure_a, pressure_b, position, spool):
    """g [N/s/A] on the spool's side, and what f_h' loses per velocity [N/m], of the learned model."""
    n, stiff = physics.numbers(c), physics.stiffnesses(c, position)
    into_a, into_b, valve_gain = physics.flow_gains(c, pressure_a, pressure_b, spool + c[OFFSET])
    least = least_gain(n.piston_area, stiff[0], valve_gain, c[SUPPLY])
    return max(eq.force_rate(n, stiff, (into_a, into_b), 0.0), least), -eq.force_rate(n, stiff, (0.0, 0.0), 1.0)


@njit
def least_gain(area, stiffness_a, valve_gain, supply):
    """Smallest g [N/s/A] of a linearization: a chamber at its limit has none."""
    return 0.1 * area * stiffness_a * valve_gain * math.sqrt(0.5 * supply)


@njit(inline="always")
def linearize(loop, hidden, x, nominal_current, current, proportional_gain, scales, step):
    """Fill `step` at x (8,), hidden states (3,), for the nominal and the valve's current [A], K_p and (C_1, C_2)."""
    c, scale = loop.model[0], loop.scale
    structured_kernels.full_state(c, x, hidden, step.full)
    before, after = step.full, step.after
    copies.vector(after, before)
    share_a, share_b = shares(c, x[POSITION])
    gain = hydraulic_slopes(c, before[0], before[1], before[2], hidden[SPOOL])[0]
    _embed(c, scale, share_a, share_b, gain, step.nudges)
    structured_kernels.advance_tangents(loop.free, after, current, step.nudges, step.rates)
    _state_rate(c, before, after, step.state_rate)
    side = math.copysign(1.0, hidden[SPOOL] + c[OFFSET])
    if side * (after[4] + c[OFFSET]) < 0.0:  # the spool passes zero: see CLOSED
        closed = side * CLOSED - c[OFFSET]
        copies.vector(after, before)
        after[4], after[5] = closed, 0.0
        _embed(c, scale, share_a, share_b, gain, step.nudges)
        structured_kernels.advance_tangents(loop.free, after, closed, step.nudges, step.rates)
    gain = hydraulic_slopes(c, after[0], after[1], after[2], hidden[SPOOL])[0]
    _read(c, scale, gain, step.nudges, step.rates, step.transition, step.push)
    step.transition[Q_BOX_VELOCITY, Q_BOX_VELOCITY] = loop.model[4][1]  # the differentiator's memory
    law_feedback(loop, x, math.copysign(nominal_current, side), proportional_gain, scales, share_a, share_b, step)


@njit(inline="always")
def law_feedback(loop, x, nominal_current, proportional_gain, scales, share_a, share_b, step):
    """Feedback K [A] of the force law into `step`; a change of f_h is `share_a`, `share_b` of the pressures [Pa/N]."""
    law, feedback, scale = step.law, step.feedback, loop.scale
    force_law.gradient(loop.bench, x, nominal_current, proportional_gain, loop.gain_floor, law, scales)
    feedback[:] = 0.0
    feedback[Q_HYDRAULIC] = (law[PRESSURE_A] * share_a + law[PRESSURE_B] * share_b) * scale[Q_HYDRAULIC]
    feedback[Q_LOAD] = law[LOAD_FORCE] * scale[Q_LOAD]
    feedback[Q_POSITION] = law[POSITION] * scale[Q_POSITION]
    feedback[Q_BOX_VELOCITY] = law[VELOCITY] * scale[Q_BOX_VELOCITY]


@njit
def _embed(c, scale, share_a, share_b, gain, nudges):
    """Nudges of the learned state for the first seven coordinates, and for the current in the last column."""
    nudges[:] = 0.0
    nudges[0, Q_HYDRAULIC], nudges[1, Q_HYDRAULIC] = scale[Q_HYDRAULIC] * share_a, scale[Q_HYDRAULIC] * share_b
    nudges[4, Q_SPOOL], nudges[5, Q_SPOOL_RATE] = scale[Q_SPOOL] / gain, scale[Q_SPOOL_RATE] / gain
    nudges[6, Q_LOAD], nudges[7, Q_LOAD_RATE] = scale[Q_LOAD] / c[GAIN_L], scale[Q_LOAD_RATE] / c[GAIN_L]
    nudges[2, Q_POSITION], nudges[3, Q_VELOCITY] = scale[Q_POSITION], scale[Q_VELOCITY]
    nudges[CURRENT, INPUT] = 1.0


@njit
def _read(c, scale, gain, nudges, rates, transition, push):
    """F but for the box's memory, and G, from the nudges a sample later."""
    area, ratio = c[GAIN_H] * c[AREA] / scale[Q_HYDRAULIC], c[RATIO]
    for k in range(LOOP):
        transition[Q_HYDRAULIC, k] = area * (nudges[0, k] - ratio * nudges[1, k])
        transition[Q_SPOOL, k] = gain / scale[Q_SPOOL] * nudges[4, k]
        transition[Q_SPOOL_RATE, k] = gain / scale[Q_SPOOL_RATE] * nudges[5, k]
        transition[Q_LOAD, k] = c[GAIN_L] / scale[Q_LOAD] * nudges[6, k]
        transition[Q_LOAD_RATE, k] = c[GAIN_L] / scale[Q_LOAD_RATE] * nudges[7, k]
        transition[Q_POSITION, k] = nudges[2, k] / scale[Q_POSITION]
        transition[Q_VELOCITY, k] = nudges[3, k] / scale[Q_VELOCITY]
        transition[Q_BOX_VELOCITY, k] = rates[2, k] / scale[Q_BOX_VELOCITY]
    for i in range(LOOP):
        push[i], transition[i, INPUT] = transition[i, INPUT], 0.0


@njit
def _state_rate(c, before, after, rate):
    """x' over the model's sample, without the readings' noise."""
    area = c[GAIN_H] * c[AREA]
    rate[0] = area * (after[0] - before[0] - c[RATIO] * (after[1] - before[1])) / SAMPLE_PERIOD
    rate[2] = c[GAIN_L] * (after[6] - before[6]) / SAMPLE_PERIOD
    rate[4], rate[5], rate[6] = (after[:3] - before[:3]) / SAMPLE_PERIOD
    rate[1], rate[3], rate[7] = (after[9:12] - before[9:12]) / SAMPLE_PERIOD
