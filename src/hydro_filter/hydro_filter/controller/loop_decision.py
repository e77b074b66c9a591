# SPDX-License-Identifier: Apache-2.0
"""Filter with the scheduled metric: from one sample to one correction, in one compiled call.

::

    sample, memory ──> linearize, displace ──> v, F, G, K ──┐
                       K_p ──> scheduled metric M ──────────┼──> quadratic in du ──> half-line ──> smallest du
                       law's integral ──> w ────────────────┘

The law is known by f_c, f_c', C_1, C_2 (`hydro_filter.model.sample.Sample.followed`). v is from f_r whatever the law
follows. A loop that decays does so whatever it follows; where the correction closes the loop, what the law asks for
beyond the trajectory of f_r is a known disturbance beside w.

Where the valve has an overlap, du is counted as what of it passes (`overlap`), and the half-line as the current that
makes this.

Samples must be consecutive: the memory simulates the spool from their currents. See `loop_filter` for objects around
this call.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from hydro_core.signals import SAMPLE_PERIOD, FloatArray
from hydro_filter import certificate
from hydro_filter.metric import MetricParts, evaluate, scratch, uncertified
from hydro_filter.model import overlap
from hydro_filter.model.coordinates import Q_VELOCITY
from hydro_filter.model.linearization import displace, linearize
from hydro_filter.model.loop import step_of
from hydro_filter.model.observer import follow, reset, settle
from hydro_filter.model.overlap import Overlap
from hydro_filter.model.parts import Loop, Step
from hydro_filter.model.sample import LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, STATES, VELOCITY
from hydro_sim.jit import njit
from hydro_sim.model.hydraulics import input_gain, velocity_term

SAME = 1e-3
"""Difference of C_1 that is none: the box tells it in single precision."""


class LoopParts(NamedTuple):
    """Inputs of `decide` that do not change from sample to sample."""

    loop: Loop
    metric: MetricParts
    rate: float
    """lambda [1/s] for gains of the certified range."""
    foreign_rate: float
    """lambda [1/s] for all other gains: how fast the correction makes the error decay."""
    noise_size: float
    """v'Mv of the noise for gains of the range: what is no more than that is nothing."""
    foreign_noise_size: float
    """The same for all other gains, whose metric has another size."""
    integral_allowance: float
    """Allowance of the law's integral I [N/s]: its share for disturbances on stable runs."""
    overlap: Overlap = Overlap()
    """Of the model's valve."""
    velocity_compensation: float = 1.0
    """C_1 of the law that the metric is made for, at C_2 = 1."""


class Workspace(NamedTuple):
    """Scratch arrays of one caller; created by `workspace`."""

    step: Step
    factor: FloatArray
    metric: FloatArray
    """M, shape (n, n) for n coordinates."""
    v: FloatArray
    next_v: FloatArray
    after_v: FloatArray


class Decision(NamedTuple):
    """Result of `decide`."""

    delta_u: float
    """A."""
    before: float
    """M_c [1/s] without the correction."""
    after: float
    """M_c [1/s] with it."""
    status: int
    """`hydro_core.signals.CorrectionStatus`."""


class Problem(NamedTuple):
    """The QP of one sample: `a du <= b`, `low <= du <= high`; M_c as a function of what of du passes the overlap."""

    a: float
    b: float
    low: float
    high: float
    bent: float
    slope: float
    level: float
    best: float
    """A, the du with the smallest M_c."""
    applied: float
    """A, what the law alone gives the valve."""


def workspace(parts: LoopParts) -> Workspace:
    """Allocate a workspace."""
    displacements = (np.zeros(len(parts.loop.scale)) for _ in range(3))
    return Workspace(step_of(parts.loop), *scratch(parts.metric), *displacements)


@njit(inline="always")
def integral_term(bench, gain_floor, x, nominal_current, proportional_gain, law):
    """Return I [N/s] of the force law, of either form, and C_2 g [N/s/A], from the law's current.

    `law`: f_c [N], f_c' [N/s], C_1, C_2.
    """
    followed, followed_rate, c_1, c_2 = law
    position = min(max(x[POSITION], 0.0), bench.stroke)
    gain = max(c_2 * input_gain(bench, position, x[PRESSURE_A], x[PRESSURE_B], nominal_current), gain_floor)
    driven = nominal_current * gain + c_1 * velocity_term(bench, position, x[VELOCITY])
    return driven - followed_rate - proportional_gain * (followed - x[LOAD_FORCE]), gain


@njit(inline="always")
def feedforward_excess(bench, x, velocity, reference, reference_rate, proportional_gain, law):
    """Return what the law asks for on the reference's trajectory beyond what that needs [N/s]; the paper's law: zero.

    There, at the reference's `velocity` [m/s], the law gives f_c' + K_p (f_c - f_r) - C_1 h, and the bench needs
    C_2 (f_r' - h).
    """
    followed, followed_rate, c_1, c_2 = law
    moving = velocity_term(bench, min(max(x[POSITION], 0.0), bench.stroke), velocity)
    given = followed_rate + proportional_gain * (followed - reference) - c_1 * moving
    return given - c_2 * (reference_rate - moving)


@njit(inline="always")
def certified_gain(parts, gain, law):
    """Return the K_p [1/s] at C_2 = 1 of the same loop; infinite if C_1 is another than the metric is made for."""
    c_1, c_2 = law[2], law[3]
    return gain / c_2 if abs(c_1 - c_2 * parts.velocity_compensation) <= SAME * c_2 else math.inf


@njit(inline="always")
def build_problem(parts, memory, x, nominal, current, reference, reference_rate, gain, law, workspace):
    """Build the QP of one finite sample of an armed bench, and advance the memory."""
    loop, metric, step = parts.loop, workspace.metric, workspace.step
    settle(loop, memory, x, current, reference_rate)
    linearize(loop, memory.hidden, x, nominal, current, gain, (law[2], law[3]), step)
    displace(loop, memory, x, reference, reference_rate, workspace.v)
    follow(loop, memory, x, current, reference_rate)
    known = certified_gain(parts, gain, law)
    evaluate(parts.metric, known, workspace.factor, metric)
    outside = uncertified(parts.metric, known)
    rate = parts.foreign_rate if outside else parts.rate
    term, law_gain = integral_term(loop.bench[0], loop.gain_floor, x, nominal, gain, law)
    asked = certificate.excess_integral(term, parts.integral_allowance) / law_gain
    if outside:
        velocity = x[VELOCITY] - loop.scale[Q_VELOCITY] * workspace.v[Q_VELOCITY]
        asked += feedforward_excess(loop.bench[0], x, velocity, reference, reference_rate, gain, law) / law_gain
    limit = loop.current_max
    applied = min(max(nominal, -limit), limit)
    bent, slope, level, size = certificate.quadratic(
        step, metric, workspace.v, current - overlap.lost(parts.overlap, current) - nominal + asked,
        asked - overlap.lost(parts.overlap, applied), rate, workspace.next_v, workspace.after_v,
    )  # fmt: skip
    share = certificate.displacement_share(size, parts.foreign_noise_size if outside else parts.noise_size)
    slope, level = share * slope, share * share * level
    a, b, best = certificate.half_line(bent, slope, level)
    if a != 0.0 and math.isfinite(a):
        b = a * overlap.change_for(parts.overlap, applied, b / a)
    best = overlap.change_for(parts.overlap, applied, best)
    return Problem(a, b, -limit - applied, limit - applied, bent, slope, level, best, applied)


@njit
def certificate_before_after(of, problem, change):
    """Return M_c [1/s] before and with a change of the current [A], through an `Overlap`."""
    moved = overlap.passed_change(of, problem.applied, change)
    after = problem.bent * moved * moved + 2.0 * problem.slope * moved + problem.level
    return problem.level / SAMPLE_PERIOD, after / SAMPLE_PERIOD


@njit
def correction_of(nominal, change, limit):
    """Return delta_u [A] such that sat(u_nom + delta_u) = sat(u_nom) + change."""
    return change + (min(max(nominal, -limit), limit) - nominal) if change != 0.0 else 0.0


@njit
def least_violation(of, problem):
    """Return the change [A] with the smallest M_c, if none restores the certificate, and its status."""
    change = min(max(problem.best, problem.low), problem.high)
    before, after = certificate_before_after(of, problem, change)
    removed = SAMPLE_PERIOD * (before - after)
    if removed < certificate.LEAST_IMPROVEMENT * problem.level:
        return 0.0, certificate.INFEASIBLE
    return change, certificate.RELAXED


@njit
def finite(x, nominal, current, reference, reference_rate, gain, law):
    """Return whether all inputs of a decision are finite, and C_2 above 0."""
    good = math.isfinite(nominal) and math.isfinite(current) and math.isfinite(reference)
    good = good and math.isfinite(reference_rate) and math.isfinite(gain) and law[3] > 0.0
    for each in law:
        good = good and math.isfinite(each)
    for i in range(STATES):
        good = good and math.isfinite(x[i])
    return good


@njit(inline="always")
def decide(parts, memory, x, nominal, current, reference, reference_rate, gain, law, armed, workspace):
    """Decide the correction of one sample.

    Parameters
    ----------
    parts, workspace
        `loop_filter.LoopFilter.parts`, `space(parts)`.
    memory
        One record of `MEMORY_DTYPE`, zeros at the beginning.
    x
        State, shape (8,).
    nominal, current
        u_nom and the valve's actual current [A].
    reference, reference_rate
        f_r [N], f_r' [N/s].
    gain
        K_p + delta K_p [1/s].
    law
        f_c [N], f_c' [N/s], C_1, C_2; of the paper's law f_r, f_r', 1.0, 1.0.
    armed
        Whether the valve follows the law; if not, no correction is made.
    """
    if not finite(x, nominal, current, reference, reference_rate, gain, law):
        reset(memory)
        return Decision(0.0, math.nan, math.nan, certificate.NAN)
    problem = build_problem(parts, memory, x, nominal, current, reference, reference_rate, gain, law, workspace)
    if not armed:
        return Decision(0.0, 0.0, 0.0, certificate.PASS)
    return solution(parts, problem, nominal)


@njit
def solution(parts, problem, nominal):
    """Return the decision of an armed bench's problem, for the law's current [A]."""
    if math.isnan(problem.a) and math.isfinite(problem.best):
        change, status = least_violation(parts.overlap, problem)
    else:
        change, status = certificate.closed_form_kernel(problem.a, problem.b, problem.low, problem.high)
    before, after = certificate_before_after(parts.overlap, problem, change)
    return Decision(correction_of(nominal, change, parts.loop.current_max), before, after, status)
