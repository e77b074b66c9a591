# SPDX-License-Identifier: Apache-2.0
"""The learned filter with finite differences in place of its derivatives, all else the same: what exactness saves.

F and G from central differences of the learned model's own sample, K of the box's law, M' of the metric along x'.
Compiled as the exact ones are.
"""

from __future__ import annotations

import numpy as np
from numba import njit

from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_filter.certificate import sampled
from hydro_filter.controller import loop_decision
from hydro_filter.controller.loop_decision import Problem
from hydro_filter.controller.loop_filter import FITS, NOT_FINITE, LoopFilter
from hydro_filter.metric import network
from hydro_filter.model import displacement, structured_kernels
from hydro_filter.model.loop_model import LOOP, hydraulic_slopes, shares
from hydro_filter.model.state import STATES
from hydro_sim.box import force_law
from hydro_sim.structured import integration, rollout
from hydro_sim.structured.physics import AREA, GAIN_H, GAIN_L, OFFSET, RATIO
from hydro_sim.structured.rollout import FULL

STEP = 1e-4
"""Of the differences, in units of the loop's scale."""
CURRENT_STEP = 1e-6
"""A."""


@njit
def build_problem(parts, memory, x, nominal, current, reference, reference_rate, gain, law, workspace):
    """`loop_decision.build_problem` by differences."""
    loop, value, step = parts.loop, workspace.value, workspace.step
    displacement.settle(loop, memory, x, current, reference_rate)
    linearize(loop, memory.hidden, x, nominal, current, gain, step)
    displacement.displace(loop, memory, x, reference, reference_rate, workspace.v)
    displacement.follow(loop, memory, x, current, reference_rate)
    _metric(parts.metric, x, step.state_rate, gain, value)
    outside = network.uncertified(parts.metric, gain)
    rate = parts.foreign_rate if outside else parts.rate
    term, law_gain = loop_decision.integral_term(loop.bench[0], loop.gain_floor, x, nominal, gain, law)
    asked = sampled.excess_integral(term, parts.integral_allowance) / law_gain
    bent, slope, level, size = sampled.quadratic(
        step, value, workspace.v, current - nominal + asked, asked, rate, workspace.next_v, workspace.after_v
    )
    share = sampled.displacement_share(size, parts.foreign_noise_size if outside else parts.noise_size)
    slope, level = share * slope, share * share * level
    a, b, best = sampled.half_line(bent, slope, level)
    limit = loop.current_max
    applied = min(max(nominal, -limit), limit)
    return Problem(a, b, -limit - applied, limit - applied, bent, slope, level, best, applied)


@njit
def _metric(parts, x, state_rate, gain, value):
    span = SAMPLE_PERIOD * 1e-2
    network.evaluate(parts, x - span * state_rate, state_rate, gain, value)
    below = value.matrix.copy()
    network.evaluate(parts, x + span * state_rate, state_rate, gain, value)
    turn = (value.matrix - below) / (2.0 * span)
    network.evaluate(parts, x, state_rate, gain, value)
    value.rate[:] = turn


@njit
def _advance(loop, full, current, after):
    c, layers, center, scale, memories = loop.free
    a1, a2 = np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    after[:] = full
    rollout.advance_full(
        c, layers, center, scale, memories, after, current, integration.scratch(), np.empty(5), a1, a2, np.empty(3),
        np.empty(8),
    )  # fmt: skip


@njit
def _shown(loop, full, gain, q):
    c = loop.model[0]
    q[0] = c[GAIN_H] * c[AREA] * (full[0] - c[RATIO] * full[1])
    q[1], q[2], q[3], q[4] = gain * full[4], gain * full[5], c[GAIN_L] * full[6], c[GAIN_L] * full[7]
    q[5], q[6], q[7] = full[2], full[3], full[11]
    for i in range(LOOP):
        q[i] /= loop.scale[i]


@njit
def _moved(loop, full, share_a, share_b, gain, k, width, out):
    c, change = loop.model[0], width * loop.scale[k]
    out[:] = full
    if k == 0:
        out[0] += share_a * change
        out[1] += share_b * change
    elif k <= 2:
        out[3 + k] += change / gain
    elif k <= 4:
        out[3 + k] += change / c[GAIN_L]
    else:
        out[(2, 3, 11)[k - 5]] += change


@njit
def linearize(loop, hidden, x, nominal, current, proportional_gain, step):
    """`loop_model.linearize` by differences."""
    c = loop.model[0]
    full, after, q, p = step.full, step.after, np.empty(LOOP), np.empty(LOOP)
    probe, end = np.empty(FULL), np.empty(FULL)
    structured_kernels.full_state(c, x, hidden, full)
    _advance(loop, full, current, after)
    share_a, share_b = shares(c, x[6])
    gain = hydraulic_slopes(c, full[0], full[1], full[2], hidden[0])[0]
    gain_after = hydraulic_slopes(c, after[0], after[1], after[2], hidden[0])[0]
    for k in range(LOOP):
        _moved(loop, full, share_a, share_b, gain, k, STEP, probe)
        _advance(loop, probe, current, end)
        _shown(loop, end, gain_after, q)
        _moved(loop, full, share_a, share_b, gain, k, -STEP, probe)
        _advance(loop, probe, current, end)
        _shown(loop, end, gain_after, p)
        step.transition[:, k] = (q - p) / (2.0 * STEP)
    _advance(loop, full, current + CURRENT_STEP, end)
    _shown(loop, end, gain_after, q)
    _advance(loop, full, current - CURRENT_STEP, end)
    _shown(loop, end, gain_after, p)
    step.push[:] = (q - p) / (2.0 * CURRENT_STEP)
    _feedback(loop, hidden, x, nominal, proportional_gain, share_a, share_b, step.feedback)
    rate = step.state_rate
    rate[0] = c[GAIN_H] * c[AREA] * (after[0] - full[0] - c[RATIO] * (after[1] - full[1])) / SAMPLE_PERIOD
    rate[2] = c[GAIN_L] * (after[6] - full[6]) / SAMPLE_PERIOD
    rate[4], rate[5], rate[6] = (after[:3] - full[:3]) / SAMPLE_PERIOD
    rate[1], rate[3], rate[7] = (after[9:12] - full[9:12]) / SAMPLE_PERIOD


@njit
def _feedback(loop, hidden, x, nominal, proportional_gain, share_a, share_b, feedback):
    """K, of the law with the reference's rate that makes it give the nominal current."""
    bench, probe = loop.bench[0], np.empty(STATES)
    side = np.copysign(nominal, hidden[0] + loop.model[0][OFFSET])
    still = force_law.nominal_current(bench, x, 0.0, 0.0, 0.0, proportional_gain, loop.gain_floor)
    unit = force_law.nominal_current(bench, x, 0.0, 0.0, np.copysign(1e7, side), proportional_gain, loop.gain_floor)
    wanted = (side - still) / (unit - still) * np.copysign(1e7, side)
    feedback[:] = 0.0
    for k in (0, 3, 5, 7):
        values = (0.0, 0.0)
        for sign in (1.0, -1.0):
            change, error = sign * STEP * loop.scale[k], 0.0
            probe[:] = x
            if k == 0:
                probe[4] += share_a * change
                probe[5] += share_b * change
            elif k == 3:
                error = -change
            else:
                probe[6 if k == 5 else 7] += change
            current = force_law.nominal_current(bench, probe, error, 0.0, wanted, proportional_gain, loop.gain_floor)
            values = (values[1], current)
        feedback[k] = (values[0] - values[1]) / (2.0 * STEP)


@njit
def propose(box, memory, x, nominal, current, reference, reference_rate, gain, law):
    """`loop_filter.propose` by differences, of the paper's law; nothing watches the model."""
    parts, workspace, _, _ = box[0]
    if not loop_decision.finite(x, nominal, current, reference, reference_rate, gain, law):
        return NOT_FINITE, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    p = build_problem(parts, memory[0], x, nominal, current, reference, reference_rate, gain, law, workspace)
    return FITS, p.a, p.b, p.low, p.high, p.bent, p.slope, p.level, p.best, p.applied


class DifferencedLoopFilter(LoopFilter):
    """`LoopFilter` by differences."""

    _propose = staticmethod(propose)
