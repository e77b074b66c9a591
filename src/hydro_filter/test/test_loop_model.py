# SPDX-License-Identifier: Apache-2.0
"""The loop's F, G, K are the derivatives of what the learned model and the force law do, by central differences."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter import model_kernels
from hydro_filter.loop_model import (
    LOOP,
    Q_BOX_VELOCITY,
    Q_HYDRAULIC,
    Q_LOAD,
    Q_LOAD_RATE,
    Q_POSITION,
    Q_SPOOL,
    Q_SPOOL_RATE,
    Q_VELOCITY,
    LoopModel,
    hydraulic_slopes,
    linearize,
    loop_model,
    loop_step,
    shares,
)
from hydro_filter.state import LOAD_FORCE, POSITION, PRESSURE_A, PRESSURE_B, VELOCITY
from hydro_sim import force_law
from hydro_sim.bench import Bench
from hydro_sim.learned import integration, structured
from hydro_sim.learned.model import Learned
from hydro_sim.learned.physics import AREA, GAIN_H, GAIN_L, RATIO
from hydro_sim.learned.structured import INPUTS, OUTPUTS

PLACES = {Q_SPOOL: 4, Q_SPOOL_RATE: 5, Q_LOAD: 6, Q_LOAD_RATE: 7, Q_POSITION: 2, Q_VELOCITY: 3, Q_BOX_VELOCITY: 11}
HIDDEN = np.array([2e-3, 0.3, 1e-5])
CURRENT = 3e-3


@pytest.fixture(scope="module")
def loop(bench: Bench) -> LoopModel:
    return loop_model(Learned.load().model, bench)


def advanced(loop: LoopModel, full: FloatArray, current: float) -> FloatArray:
    """The full state a sample later, without dry friction, by the model's own integrator."""
    c, layers, center, scale, memories = loop.free
    after, measured, x, r = full.copy(), np.empty(8), np.empty(INPUTS), np.empty(OUTPUTS)
    a1, a2 = np.empty(layers.b1.shape[0]), np.empty(layers.b2.shape[0])
    work = integration.scratch()
    structured.advance_full(c, layers, center, scale, memories, after, current, work, x, a1, a2, r, measured)
    return after


def coordinates(loop: LoopModel, full: FloatArray) -> FloatArray:
    """q in units of its scale; the spool by the force rate that it drives on its side of zero."""
    c = loop.model[0]
    q = np.empty(LOOP)
    q[Q_HYDRAULIC] = c[GAIN_H] * c[AREA] * (full[0] - c[RATIO] * full[1])
    for row, place in PLACES.items():
        q[row] = full[place] * (c[GAIN_L] if row in (Q_LOAD, Q_LOAD_RATE) else 1.0)
    return q / loop.scale


def gain_at(loop: LoopModel, full: FloatArray) -> float:
    return float(hydraulic_slopes(loop.model[0], full[0], full[1], full[2], HIDDEN[0])[0])


def nudged(loop: LoopModel, full: FloatArray, column: int, size: float) -> FloatArray:
    """The full state moved along one loop coordinate [units of scale]."""
    c, moved, step = loop.model[0], full.copy(), size * loop.scale[column]
    if column == Q_HYDRAULIC:
        share_a, share_b = shares(c, full[2])
        moved[0] += share_a * step
        moved[1] += share_b * step
    else:
        factor = 1.0 / c[GAIN_L] if column in (Q_LOAD, Q_LOAD_RATE) else 1.0
        factor /= gain_at(loop, full) if column in (Q_SPOOL, Q_SPOOL_RATE) else 1.0
        moved[PLACES[column]] += factor * step
    return moved


def test_one_sample_is_linearized_exactly(loop: LoopModel, states: FloatArray) -> None:
    step, full = loop_step(), np.empty(12)
    for x in states[:40]:
        linearize(loop, HIDDEN, x, CURRENT, CURRENT, 60.0, step)
        model_kernels.lift(loop.model[0], x, HIDDEN, full)
        weight = np.ones(LOOP)
        weight[[Q_SPOOL, Q_SPOOL_RATE]] = gain_at(loop, advanced(loop, full, CURRENT))
        for column in range(LOOP):
            h = 1e-6
            ends = [advanced(loop, nudged(loop, full, column, sign * h), CURRENT) for sign in (1.0, -1.0)]
            slope = (coordinates(loop, ends[0]) - coordinates(loop, ends[1])) / (2.0 * h) * weight
            np.testing.assert_allclose(step.transition[:, column], slope, rtol=2e-5, atol=2e-6)
        h = 1e-8
        ends = [advanced(loop, full, CURRENT + sign * h) for sign in (1.0, -1.0)]
        slope = (coordinates(loop, ends[0]) - coordinates(loop, ends[1])) / (2.0 * h) * weight
        np.testing.assert_allclose(step.push, slope, rtol=2e-5, atol=1e-6 * np.abs(slope).max())


def test_the_feedback_is_the_force_laws(loop: LoopModel, states: FloatArray, bench: Bench) -> None:
    step, c = loop_step(), loop.model[0]

    def law(x: FloatArray) -> float:
        error, rate, gains = 50.0 - x[LOAD_FORCE], 2000.0, (60.0, 0.0)
        return float(force_law.nominal_current(loop.bench[0], x, error, 0.0, rate, *gains, loop.gain_floor))

    for x in states[:40]:
        nominal = law(x)
        side = np.copysign(np.abs(HIDDEN), nominal)  # the spool on the law's side, as it is but for milliseconds
        linearize(loop, side, x, nominal, nominal, 60.0, step)
        share_a, share_b = shares(c, x[POSITION])
        moves = {
            Q_HYDRAULIC: {PRESSURE_A: share_a, PRESSURE_B: share_b}, Q_LOAD: {LOAD_FORCE: 1.0},
            Q_POSITION: {POSITION: 1.0}, Q_BOX_VELOCITY: {VELOCITY: 1.0},
        }  # fmt: skip
        for column in range(LOOP):
            slope = 0.0
            if column in moves:
                h = 1e-5 * loop.scale[column]
                ends = [x.copy(), x.copy()]
                for entry, share in moves[column].items():
                    ends[0][entry] += h * share
                    ends[1][entry] -= h * share
                slope = (law(ends[0]) - law(ends[1])) / (2e-5)
            assert step.feedback[column] == pytest.approx(slope, rel=1e-5, abs=1e-9)


def test_the_law_makes_the_loop_nearly_the_same_everywhere(loop: LoopModel) -> None:
    """The slowest decay at K_p = 90 hardly depends on where the piston stands and how fast it moves."""
    step, decays = loop_step(), []
    for position in (0.025, 0.04, 0.055):
        for opening in (-3e-3, -1e-4, 1e-4, 3e-3):
            x = np.array([0.0, 0.0, 2e4 * (position - 0.04), 0.0, 6e6, 9.9e6, position, 0.0])
            gain, stiffness = hydraulic_slopes(loop.model[0], x[4], x[5], x[6], opening)
            x[VELOCITY] = gain * opening / (stiffness + 2e4)  # what flows in goes into motion, but for the spring
            linearize(loop, np.array([opening, 0.0, 0.0]), x, opening, opening, 90.0, step)
            closed = step.transition + np.outer(step.push, step.feedback)
            decays.append(-np.log(np.abs(np.linalg.eigvals(closed)).max()) / 1e-3)
    assert min(decays) > 0.6
    assert max(decays) < 2.5


def test_a_spool_that_passes_zero_is_linearized_on_the_side_it_comes_from(loop: LoopModel) -> None:
    x, step = np.array([0.0, 0.0, 0.0, 0.0, 6e6, 9.9e6, 0.04, 0.0]), loop_step()
    linearize(loop, np.array([1e-5, 0.0, 0.0]), x, 1e-5, 1e-5, 90.0, step)
    still = step.transition.copy()
    linearize(loop, np.array([1e-5, -0.1, 0.0]), x, 1e-5, -3e-3, 90.0, step)
    np.testing.assert_allclose(step.transition, still, rtol=1e-3, atol=1e-4)
