# SPDX-License-Identifier: Apache-2.0
"""The learned models' Jacobians against central differences of the models' own steps, and batches against single calls.

The models have kinks (ReLUs, the valve's edges, the bristle at rest). Where two widths of differences do not agree
with each other one lies in between: such columns are left out, and counted.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter import dynamics, hidden_states, model_kernels
from hydro_filter.dynamics import AnalyticDynamics
from hydro_filter.model_dynamics import NetworkDynamics, StructuredDynamics, model_dynamics
from hydro_filter.state import STATES, state_scale
from hydro_sim.bench import Bench
from hydro_sim.learned import integration, mlp, network, structured
from hydro_sim.learned.model import Learned
from hydro_sim.learned.network_model import NetworkModel
from hydro_sim.learned.structured import FULL, INPUTS, OUTPUTS
from hydro_sim.learned.structured_model import StructuredModel

LIMIT = 1e-6  # of a normalized matrix' largest entry
CURRENT_SCALE = 0.01
COUNT = 60


@pytest.fixture(scope="module")
def model() -> StructuredModel:
    """The shipped constants with a network that does something: the shipped one is zero."""
    shipped = Learned.load().model
    assert isinstance(shipped, StructuredModel)
    flat = mlp.initial(np.random.default_rng(3), INPUTS, shipped.hidden, OUTPUTS)
    scale = np.array([5e6, 5e6, 0.02, 0.1, 0.02])
    return replace(shipped, flat=flat, center=np.array([8e6, 8e6, 0.04, 0.0, 0.0]), scale=scale)


@pytest.fixture(scope="module")
def network_model() -> NetworkModel:
    flat = mlp.initial(np.random.default_rng(4), network.INPUTS, (32, 32), STATES)
    center = np.array([0.0, 0.0, 0.0, 0.0, 8e6, 8e6, 0.04, 0.0])
    scale = np.array([200.0, 3e3, 200.0, 3e3, 2e6, 2e6, 0.01, 0.1])
    return NetworkModel(
        flat=flat, hidden=(32, 32), center=center, scale=scale, current_scale=0.01, rate_scale=20.0 * scale, rest=center
    )


@pytest.fixture(scope="module")
def currents() -> FloatArray:
    rng = np.random.default_rng(8)
    return rng.choice([-1.0, 1.0], COUNT) * rng.uniform(1e-3, 0.05, COUNT)


@pytest.fixture(scope="module")
def hidden(currents: FloatArray) -> FloatArray:
    """Spool about the current, moving, bristle anywhere; shape (COUNT, 3)."""
    rng = np.random.default_rng(9)
    rates, bristles = rng.normal(0.0, 1.0, COUNT), rng.uniform(-5e-5, 5e-5, COUNT)
    return np.column_stack([currents * rng.uniform(0.6, 1.2, COUNT), rates, bristles])


def slopes(f: Callable[[FloatArray], FloatArray], at: FloatArray, scale: FloatArray, width: float) -> FloatArray:
    """df/dx by central differences of fourth order, `width` relative to each entry's scale."""
    columns = []
    for i in range(len(at)):
        step = np.zeros(len(at))
        step[i] = width * scale[i]
        near, far = f(at + step) - f(at - step), f(at + 2 * step) - f(at - 2 * step)
        columns.append((8.0 * near - far) / (12.0 * step[i]))
    return np.stack(columns, axis=-1)


class Comparison:
    """Compares column by column, in normalized units."""

    def __init__(self, rows: FloatArray, columns: FloatArray) -> None:
        self.rows, self.columns = rows, columns
        self.compared = self.kinks = 0

    def check(self, exact: FloatArray, f: Callable[[FloatArray], FloatArray], at: FloatArray) -> None:
        """`exact`: df/dx at `at`."""
        wide, narrow = (slopes(f, at, self.columns, width) * self._unit for width in (2e-4, 1e-4))
        largest = np.abs(exact * self._unit).max()
        for k in range(len(at)):
            if np.abs(wide[:, k] - narrow[:, k]).max() > 0.3 * LIMIT * largest:
                self.kinks += 1
                continue
            self.compared += 1
            assert np.abs(exact[:, k] * self._unit[:, k] - narrow[:, k]).max() <= LIMIT * largest, k

    @property
    def _unit(self) -> FloatArray:
        return self.columns / self.rows[:, np.newaxis]

    def __enter__(self) -> Comparison:
        return self

    def __exit__(self, kind: object, *_: object) -> None:
        if kind is None:
            assert self.kinks <= 0.05 * self.compared, (self.kinks, self.compared)


def wide_scale(bench: Bench) -> FloatArray:
    return np.append(state_scale(bench), CURRENT_SCALE)


def jacobian(linear: dynamics.Linearization | dynamics.Transition) -> FloatArray:
    """[A B], shape (n, n + 1)."""
    return np.column_stack([linear.state_matrix, linear.input_vector])


def test_continuous_jacobians_of_the_structured_model(
    bench: Bench, model: StructuredModel, states: FloatArray, currents: FloatArray, hidden: FloatArray
) -> None:
    learned = StructuredDynamics(model)
    with Comparison(state_scale(bench), wide_scale(bench)) as comparison:
        for x, u, estimate in zip(states, currents, hidden, strict=False):
            learned.hidden = estimate
            f = lambda at: learned.linearize(at[:8], at[8]).state_rate  # noqa: E731
            comparison.check(jacobian(learned.linearize(x, u)), f, np.append(x, u))


def test_sampled_jacobians_of_the_structured_model(
    bench: Bench, model: StructuredModel, states: FloatArray, currents: FloatArray, hidden: FloatArray
) -> None:
    learned = StructuredDynamics(model)
    with Comparison(state_scale(bench), wide_scale(bench)) as comparison:
        for x, u, estimate in zip(states, currents, hidden, strict=False):
            learned.hidden = estimate
            f = lambda at: simulated(model, x_to_full(model, at[:8], estimate), at[8])[1]  # noqa: B023, E731
            comparison.check(jacobian(learned.transition(x, u)), f, np.append(x, u))


def test_sampled_jacobians_of_the_full_state(
    bench: Bench, model: StructuredModel, states: FloatArray, currents: FloatArray, hidden: FloatArray
) -> None:
    x_scale = state_scale(bench)
    scale = np.array([*x_scale[4:8], 0.01, 5.0, x_scale[2], x_scale[3], 1e-5, *x_scale[[1, 3, 7]]])
    learned = StructuredDynamics(model)
    with Comparison(scale, np.append(scale, CURRENT_SCALE)) as comparison:
        for x, u, estimate in zip(states, currents, hidden, strict=False):
            full = x_to_full(model, x, estimate)
            f = lambda at: simulated(model, at[:FULL], at[FULL])[0]  # noqa: E731
            comparison.check(jacobian(learned.transition_full(full, u)), f, np.append(full, u))


@pytest.mark.parametrize("form", ["linearize", "transition"])
def test_jacobians_of_the_papers_network(
    bench: Bench, network_model: NetworkModel, states: FloatArray, currents: FloatArray, form: str
) -> None:
    call = getattr(NetworkDynamics(network_model), form)
    with Comparison(state_scale(bench), wide_scale(bench)) as comparison:
        for x, u in zip(states, currents, strict=False):
            comparison.check(jacobian(call(x, u)), lambda at: call(at[:8], at[8])[2], np.append(x, u))


def test_sampled_jacobians_of_the_analytic_bench(bench: Bench, states: FloatArray, currents: FloatArray) -> None:
    analytic = AnalyticDynamics(bench)
    with Comparison(state_scale(bench), wide_scale(bench)) as comparison:
        for x, u in zip(states, currents, strict=False):
            f = lambda at: analytic.transition(at[:8], at[8]).after  # noqa: E731
            comparison.check(jacobian(analytic.transition(x, u)), f, np.append(x, u))


def test_the_analytic_transition_follows_the_flow(bench: Bench, states: FloatArray, currents: FloatArray) -> None:
    """Against Euler steps of a microsecond: first order, so that a tenth of a percent is all they can show."""
    analytic, scale = AnalyticDynamics(bench), state_scale(bench)
    for x, u in zip(states[:5], currents, strict=False):
        fine = x.copy()
        for _ in range(1000):
            fine += 1e-6 * analytic.linearize(fine, u).state_rate
        moved = np.abs((fine - x) / scale)
        assert np.abs((analytic.transition(x, u).after - fine) / scale).max() <= 2e-3 * moved.max()


def test_transitions_are_the_plants_own_steps(
    model: StructuredModel, states: FloatArray, currents: FloatArray, hidden: FloatArray
) -> None:
    """Bit for bit what the simulation runs."""
    learned = StructuredDynamics(model)
    for x, u, estimate in zip(states, currents, hidden, strict=False):
        full = x_to_full(model, x, estimate)
        after, measured = simulated(model, full, u)
        learned.hidden = estimate
        np.testing.assert_allclose(learned.transition(x, u).after, measured, rtol=1e-12, atol=1e-9)
        np.testing.assert_allclose(learned.transition_full(full, u).after, after, rtol=1e-12, atol=1e-12)


def test_a_network_transition_is_the_models_own_step(
    network_model: NetworkModel, states: FloatArray, currents: FloatArray
) -> None:
    """Which runs in float32."""
    learned = NetworkDynamics(network_model)
    predicted = network_model.predict(states[:COUNT], currents[:, np.newaxis])[:, 0]
    stepped = np.array([learned.transition(x, u).after for x, u in zip(states, currents, strict=False)])
    assert np.abs((predicted - stepped) / network_model.scale).max() <= 1e-5


def test_batches_are_single_calls(
    model: StructuredModel, network_model: NetworkModel, states: FloatArray, currents: FloatArray, hidden: FloatArray
) -> None:
    learned, paper, x = StructuredDynamics(model), NetworkDynamics(network_model), states[:COUNT]
    full = np.array([x_to_full(model, *pair) for pair in zip(x, hidden, strict=True)])
    batches = [
        learned.linearize_batch(x, currents, hidden),
        learned.transition_batch(x, currents, hidden),
        learned.transition_full_batch(full, currents),
        paper.linearize_batch(x, currents),
        paper.transition_batch(x, currents),
    ]
    for k in range(COUNT):
        learned.hidden = hidden[k]
        singles = [
            learned.linearize(x[k], currents[k]),
            learned.transition(x[k], currents[k]),
            learned.transition_full(full[k], currents[k]),
            paper.linearize(x[k], currents[k]),
            paper.transition(x[k], currents[k]),
        ]
        for batch, single in zip(batches, singles, strict=True):
            for many, one in zip(batch, single, strict=True):
                np.testing.assert_allclose(many[k], one, rtol=1e-12)


def test_hidden_states_follow_those_of_the_simulation() -> None:
    """From current and measured velocity alone, after a start that was wrong."""
    model = Learned.load().model
    assert isinstance(model, StructuredModel)
    learned, full = StructuredDynamics(model), model.rest.copy()
    learned.hidden = np.array([0.03, -5.0, 3e-5])
    truth, followed = [], []
    for k in range(600):
        u = 0.01 * np.sin(2 * np.pi * 4.0 * 1e-3 * k)
        truth.append(full[[4, 5, 8]])
        followed.append(learned.hidden.copy())
        learned.observe(x_of(model, full), u)
        full = simulated(model, full, u)[0]
    settled = np.array(truth)[100:]
    error = np.sqrt(np.mean((np.array(followed)[100:] - settled) ** 2, axis=0))
    assert error[0] <= 1e-9  # A: driven by the current alone
    assert error[1] <= 1e-6  # A/s
    assert error[2] <= 0.15 * np.abs(settled[:, 2]).max()  # the measured velocity is a millisecond old


def test_hidden_states_settle_where_they_are_said_to(model: StructuredModel) -> None:
    c, learned = model.compiled[0], StructuredDynamics(model)
    x = np.array([0.0, 0.0, 0.0, 0.0, 8e6, 8e6, 0.04, 0.03])
    steady = learned.hidden_at(x[np.newaxis], np.array([0.004]))[0]
    moving = np.array([-0.02, 3.0, -1e-5])
    for _ in range(300):
        hidden_states.follow(c, 0.03, 0.004, moving)
    np.testing.assert_allclose(moving, steady, rtol=1e-6, atol=1e-8)


def test_the_shipped_model_is_understood() -> None:
    assert isinstance(model_dynamics(Learned.load().model), StructuredDynamics)


def x_to_full(model: StructuredModel, x: FloatArray, hidden: FloatArray) -> FloatArray:
    full = np.empty(FULL)
    model_kernels.lift(model.compiled[0], x, hidden, full)
    return full


def x_of(model: StructuredModel, full: FloatArray) -> FloatArray:
    reading, x = np.empty(5), np.empty(8)
    structured.read(model.compiled[0], full, reading)
    structured.show(reading, full[9:], x)
    return x


def simulated(model: StructuredModel, full: FloatArray, current: float) -> tuple[FloatArray, FloatArray]:
    """The plant's own step: full state and x a sample later."""
    after, measured = full.copy(), np.empty(8)
    scratch = integration.scratch(), np.empty(INPUTS), np.empty(model.hidden[0]), np.empty(model.hidden[1])
    work, x, a1, a2 = scratch
    structured.advance_full(*model.compiled, after, current, work, x, a1, a2, np.empty(OUTPUTS), measured)
    return after, measured
