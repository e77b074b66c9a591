# SPDX-License-Identifier: Apache-2.0
"""What the learned certificate is made of, against numbers that know nothing of it: differences of the model's own step
and of the box's own law, and torch's derivatives of the network."""

from __future__ import annotations

import numpy as np
import pytest
import torch

from hydro_bridge.signals import FloatArray
from hydro_filter.metric.design import MetricDesign
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.metric.network import ENTRIES, GAIN_UNIT, INPUTS
from hydro_filter.model import loop_model, structured_kernels
from hydro_filter.model.force_law import PAPER_SCALES
from hydro_filter.model.loop_model import LOOP, LoopModel, hydraulic_slopes, shares
from hydro_sim.box import force_law
from hydro_sim.learned.model import Learned
from hydro_sim.model import hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.neural import mlp
from hydro_sim.structured import integration, rollout
from hydro_sim.structured.model import StructuredModel
from hydro_sim.structured.physics import AREA, GAIN_H, GAIN_L, OFFSET, RATIO
from hydro_sim.structured.rollout import FULL

LIMIT = 1e-6
COUNT = 40


@pytest.fixture(scope="module")
def model() -> StructuredModel:
    shipped = Learned.load().model
    assert isinstance(shipped, StructuredModel)
    return shipped


@pytest.fixture(scope="module")
def loop(model: StructuredModel, bench: Bench) -> LoopModel:
    return loop_model.loop_model(model, bench)


@pytest.fixture(scope="module")
def cases(states: FloatArray) -> list[tuple[FloatArray, FloatArray, float]]:
    """x, hidden states with the spool well on one side, current."""
    rng = np.random.default_rng(2)
    currents = rng.choice([-1.0, 1.0], COUNT) * rng.uniform(2e-3, 0.05, COUNT)
    hidden = np.column_stack([currents * rng.uniform(0.8, 1.2, COUNT), rng.normal(0, 1, COUNT), np.zeros(COUNT)])
    return [(states[k], hidden[k], float(currents[k])) for k in range(COUNT)]


@pytest.fixture(scope="module")
def metric(loop: LoopModel, bench: Bench) -> LearnedMetric:
    """A network that says something, on the solved table."""
    solved = LearnedMetric.designed(loop, bench, MetricDesign())
    return solved.with_weights(mlp.initial(np.random.default_rng(1), INPUTS, solved.hidden, ENTRIES, last=0.3))


def advanced(model: StructuredModel, constants: FloatArray, full: FloatArray, current: float) -> FloatArray:
    """The plant's own step with these constants."""
    after, (_, *others) = full.copy(), model.compiled
    space = np.empty(5), np.empty(model.hidden[0]), np.empty(model.hidden[1]), np.empty(3), np.empty(8)
    rollout.advance_full(constants, *others, after, current, integration.scratch(), *space)
    return after


def displaced(loop: LoopModel, full: FloatArray, x: FloatArray, spool: float, q: FloatArray) -> FloatArray:
    """The full state with a displacement q of the loop, in units of its scale (docstring of `loop_model`)."""
    c, change = loop.model[0], q * loop.scale
    moved = full.copy()
    gain = hydraulic_slopes(c, full[0], full[1], full[2], spool)[0]
    share_a, share_b = shares(c, x[6])
    moved[0] += share_a * change[0]
    moved[1] += share_b * change[0]
    moved[4] += change[1] / gain
    moved[5] += change[2] / gain
    moved[6] += change[3] / c[GAIN_L]
    moved[7] += change[4] / c[GAIN_L]
    moved[2] += change[5]
    moved[3] += change[6]
    moved[11] += change[7]
    return moved


def coordinates(loop: LoopModel, full: FloatArray, gain: float) -> FloatArray:
    """q of a full state in units of its scale, the spool counted by `gain`."""
    c = loop.model[0]
    force = c[GAIN_H] * c[AREA] * (full[0] - c[RATIO] * full[1])
    shown = [
        force,
        gain * full[4],
        gain * full[5],
        c[GAIN_L] * full[6],
        c[GAIN_L] * full[7],
        full[2],
        full[3],
        full[11],
    ]
    return np.array(shown) / loop.scale


def test_f_and_g_are_derivatives_of_the_models_own_sample(
    model: StructuredModel, loop: LoopModel, cases: list[tuple[FloatArray, FloatArray, float]]
) -> None:
    step, free = loop_model.loop_step(), loop.free[0]
    for x, hidden, current in cases:
        loop_model.linearize(loop, hidden, x, current, current, 60.0, PAPER_SCALES, step)
        full = np.empty(FULL)
        structured_kernels.full_state(loop.model[0], x, hidden, full)
        after = advanced(model, free, full, current)
        gain = hydraulic_slopes(loop.model[0], after[0], after[1], after[2], hidden[0])[0]

        def shown(full: FloatArray, u: float, gain: float = gain) -> FloatArray:
            return coordinates(loop, advanced(model, free, full, u), gain)

        exact = np.column_stack([step.transition, step.push * 0.01])
        numeric = np.empty((LOOP, LOOP + 1))
        width = 1e-4
        for k in range(LOOP):
            q = width * np.eye(LOOP)[k]
            sides = [shown(displaced(loop, full, x, hidden[0], sign * q), current) for sign in (1, -1, 2, -2)]
            numeric[:, k] = (8.0 * (sides[0] - sides[1]) - (sides[2] - sides[3])) / (12.0 * width)
        near, far = (shown(full, current + 0.01 * s) - shown(full, current - 0.01 * s) for s in (width, 2 * width))
        numeric[:, LOOP] = (8.0 * near - far) / (12.0 * width)
        assert np.abs(exact - numeric).max() <= LIMIT * np.abs(exact).max()


@pytest.mark.parametrize("scales", [(1.0, 1.0), (0.3, 1.0), (0.0, 2.5)])
def test_k_is_the_derivative_of_the_boxs_law(
    loop: LoopModel, cases: list[tuple[FloatArray, FloatArray, float]], scales: tuple[float, float]
) -> None:
    """With what f_h is made of, and on the spool's side of zero."""
    step, bench = loop_model.loop_step(), loop.bench[0]
    for x, hidden, current in cases:
        side = np.copysign(current, hidden[0] + loop.model[0][OFFSET])
        loop_model.linearize(loop, hidden, x, current, current, -35.0, scales, step)
        g = scales[1] * hydraulics.input_gain(bench, x[6], x[4], x[5], side)
        driven = max(g, loop.gain_floor) * side
        # the f_c' that gives this current
        wanted = driven + scales[0] * hydraulics.velocity_term(bench, x[6], x[7]) + 35.0 * 110.0

        def law(q: FloatArray, x: FloatArray = x, wanted: float = wanted) -> float:
            moved, change = x.copy(), q * loop.scale
            share_a, share_b = shares(loop.model[0], x[6])
            moved[4] += share_a * change[0]
            moved[5] += share_b * change[0]
            moved[2] += change[3]
            moved[6] += change[5]
            moved[7] += change[7]
            force = x[2] + 110.0
            known = force - moved[2], 0.0, wanted, -35.0, loop.gain_floor
            return float(force_law.nominal_current(bench, moved, *known, *scales))

        numeric, width = np.zeros(LOOP), 1e-4
        for k in range(LOOP):
            q = width * np.eye(LOOP)[k]
            numeric[k] = (8.0 * (law(q) - law(-q)) - (law(2 * q) - law(-2 * q))) / (12.0 * width)
        assert law(np.zeros(LOOP)) == pytest.approx(side, rel=1e-9)
        if abs(g / loop.gain_floor - 1.0) < 0.01:
            continue  # a kink lies within the difference's reach
        np.testing.assert_allclose(step.feedback, numeric, rtol=1e-6, atol=1e-6 * np.abs(numeric).max())


def as_torch(metric: LearnedMetric, gain: float) -> torch.nn.Module:
    """M(x) at a gain, written anew in torch, float64."""
    layers = mlp.layers(metric.flat, INPUTS, metric.hidden, ENTRIES)
    low, high = metric.gains[0], metric.gains[-1]
    outside = not low <= gain <= high
    table = [np.interp(gain, metric.gains, column) for column in metric.table[:-1].T]
    base = torch.tensor(metric.table[-1] if outside else np.array(table))
    extra = torch.tensor([0.0, 1.0] if outside else [gain / GAIN_UNIT, 0.0], dtype=torch.float64)
    weights = [torch.tensor(np.asarray(part)) for part in layers]

    class Network(torch.nn.Module):
        def forward(self, x: torch.Tensor) -> torch.Tensor:
            x = torch.clamp(x, torch.tensor(metric.low), torch.tensor(metric.high))
            z = torch.cat([(x - torch.tensor(metric.center)) / torch.tensor(metric.scale), extra])
            hidden = torch.relu(torch.relu(z @ weights[0] + weights[1]) @ weights[2] + weights[3])
            entries = hidden @ weights[4] + weights[5] + base
            rows, columns = torch.tril_indices(LOOP, LOOP)
            factor = torch.zeros((LOOP, LOOP), dtype=torch.float64).index_put((rows, columns), entries)
            return factor @ factor.T + metric.floor * torch.eye(LOOP, dtype=torch.float64)

    return Network()


@pytest.mark.parametrize("gain", [-40.0, 10.0, 42.0, 95.0, 300.0])
def test_m_and_its_rate_are_torchs(metric: LearnedMetric, states: FloatArray, gain: float) -> None:
    network, rng = as_torch(metric, gain), np.random.default_rng(6)
    for x in states[:COUNT]:
        rate = metric.scale * rng.normal(size=8) * 5.0
        matrix, turn = metric.matrix_and_rate(x, rate, gain)
        value, slope = torch.func.jvp(network, (torch.tensor(x),), (torch.tensor(rate),))
        np.testing.assert_allclose(matrix, value.numpy(), rtol=0, atol=LIMIT * np.abs(matrix).max())
        np.testing.assert_allclose(turn, slope.numpy(), rtol=0, atol=LIMIT * np.abs(turn).max())
        np.testing.assert_allclose(matrix, matrix.T, rtol=0, atol=0)
        assert np.linalg.eigvalsh(matrix)[0] > 0.0
