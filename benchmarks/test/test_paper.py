# SPDX-License-Identifier: Apache-2.0
"""`benchmarks.paper`: pieces are kept, the metric's loss is its definition's, the page says what was not run."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from benchmarks.paper import metric, report
from benchmarks.paper.certificate import AtRate, NetworkDynamics, NetworkMetric, paper_filter
from benchmarks.paper.network import NetworkModel, NetworkPlant, train
from benchmarks.paper.store import FULL, PRINTED, QUICK, RESULTS, Store
from hydro_bridge.signals import STATE_DTYPE
from hydro_filter.certificate.continuous import Certificate
from hydro_filter.controller.filter import Result
from hydro_filter.model.sample import Sample
from hydro_filter.training.data import STABLE, UNSTABLE, Rollout
from hydro_sim.files.recordings import Data, Run

STATE = np.array([50.0, 100.0, 40.0, 90.0, 6e6, 9.8e6, 0.042, 0.01])
pytestmark = pytest.mark.study
SCALE = np.array([150.0, 1500.0, 150.0, 1500.0, 7e5, 7e5, 7e-3, 7e-2])


@pytest.fixture
def model() -> NetworkModel:
    rng = np.random.default_rng(0)
    x = np.array([0.0, 0.0, 0.0, 0.0, 6e6, 9.8e6, 0.04, 0.0]) + SCALE * rng.standard_normal((400, 8))
    run = Run(name="drawn", first=0, x=x, u=1e-3 * rng.standard_normal(400))
    return NetworkModel.untrained([run], (32, 32), 0)


def network() -> torch.nn.Sequential:
    torch.manual_seed(0)
    return torch.nn.Sequential(
        torch.nn.Linear(8, 64), torch.nn.ReLU(), torch.nn.Linear(64, 64), torch.nn.ReLU(), torch.nn.Linear(64, 36)
    ).double()


def metric_of(made: torch.nn.Module, model: NetworkModel) -> NetworkMetric:
    return NetworkMetric(tuple(p.detach().numpy().T for p in made.parameters()), model.center, model.scale)


def test_a_piece_is_made_once_and_again_for_another_size(tmp_path: Path) -> None:
    made: list[int] = []

    def make() -> dict[str, object]:
        made.append(1)
        return {"value": [float("nan"), 1.0]}

    Store(tmp_path, QUICK).piece("one", make)
    again = Store(tmp_path, QUICK).piece("one", make)
    assert len(made) == 1
    assert again["value"] == [None, 1.0]
    assert Store(tmp_path, FULL).kept("one") is None
    assert Store(tmp_path, replace(QUICK, seeds=3)).kept("one") is None


def test_the_page_is_made_from_the_results_that_came_with_it(tmp_path: Path) -> None:
    page = (RESULTS.parents[2] / "docs/reports/paper.md").read_text(encoding="utf-8")
    assert page == report.text(Store(tmp_path, FULL, RESULTS), Store(tmp_path, QUICK, RESULTS))


def test_the_networks_slopes_are_its_differences(model: NetworkModel) -> None:
    dynamics = NetworkDynamics(model)
    linear = dynamics.linearize(STATE, 1e-3)
    for column in range(8):
        move = np.zeros(8)
        move[column] = 1e-6 * SCALE[column]
        up, down = (dynamics.linearize(STATE + sign * move, 1e-3).state_rate for sign in (1.0, -1.0))
        slope = (up - down) / (2.0 * move[column])
        np.testing.assert_allclose(linear.state_matrix[:, column], slope, rtol=1e-4, atol=1e-6 * np.abs(slope).max())
    up, down = (dynamics.linearize(STATE, 1e-3 + sign * 1e-9).state_rate for sign in (1.0, -1.0))
    np.testing.assert_allclose(linear.input_vector, (up - down) / 2e-9, rtol=1e-4, atol=1e-3)


def test_training_lowers_the_error_and_the_plant_steps_as_the_model_predicts(model: NetworkModel) -> None:
    rng = np.random.default_rng(1)
    u = 1e-3 * np.cumsum(rng.standard_normal(6000)) / 10.0
    x = model.center + np.outer(np.convolve(u, np.ones(50) / 50, "same") / u.std(), SCALE)
    data = Data(training=[Run(name="a", x=x, u=u)], validation=[Run(name="b", x=x[:3000], u=u[:3000])], digests={})
    began = NetworkModel.untrained(data.training, (16, 16), 0)
    starts, currents = x[1000:1500:50], u[1000:1500:50, None].repeat(20, 1)
    before = began.predict(starts, currents)
    told = train(began, data, batch=64, seed=0, epochs=20, horizon=10)
    assert told["best_epoch"] > 5
    assert not np.allclose(before, began.predict(starts, currents))
    plant = NetworkPlant(began)
    plant.state = starts[0].copy()
    stepped = np.array([plant.step(float(currents[0, 0])) for _ in range(20)])
    np.testing.assert_allclose(stepped, began.predict(starts[:1], currents[:1])[0], rtol=1e-3, atol=1e-3 * SCALE.max())


def test_the_metrics_rate_is_its_difference_along_the_motion(model: NetworkModel) -> None:
    made, motion = metric_of(network(), model), 5.0 * SCALE
    value = made.matrix(STATE)
    assert np.linalg.eigvalsh(value).min() > 0.0
    difference = (made.matrix(STATE + 1e-6 * motion) - made.matrix(STATE - 1e-6 * motion)) / 2e-6
    np.testing.assert_allclose(made.rate(STATE, motion), difference, rtol=1e-5, atol=1e-7)


def test_training_and_filter_have_the_same_certificate(model: NetworkModel) -> None:
    made, sample = network(), Sample(STATE, 1e-3, 90.0, 60.0)
    certificate = paper_filter(metric_of(made, model), model).inner.certificate
    assert isinstance(certificate, Certificate)
    rows = metric._normalized(sample, certificate.dynamics, certificate.controller, certificate.current_max)  # type: ignore[arg-type]
    parts = [torch.from_numpy(row)[None, None] for row in rows]
    grown, _ = metric.growth(made, metric.Samples(*parts, torch.tensor([[True]])))
    assert -certificate.evaluate(sample).b == pytest.approx(float(grown.detach()), rel=1e-9)


def test_the_loss_follows_the_label(model: NetworkModel) -> None:
    made, sample = network(), Sample(STATE, 1e-3, 90.0, 60.0)
    certificate = paper_filter(metric_of(made, model), model).inner.certificate
    rows = metric._normalized(sample, certificate.dynamics, certificate.controller, certificate.current_max)  # type: ignore[arg-type]
    parts = [torch.from_numpy(row)[None, None] for row in rows]
    losses = {stable: metric.loss(made, metric.Samples(*parts, torch.tensor([[stable]]))) for stable in (True, False)}
    value = -certificate.evaluate(sample).b
    weight = PRINTED["training_metric"]["contraction_weight"]
    assert float((losses[True] - losses[False]).detach()) == pytest.approx(weight * value, rel=1e-6)


def test_the_long_training_ends_when_twenty_epochs_have_gained_less_than_a_hundredth() -> None:
    falling = [2.0 * 0.999**epoch for epoch in range(60)]
    assert not metric.converged(falling[:20]) and not metric.converged(falling)  # 2 % in twenty
    flat = [*falling, *[0.995 * falling[-1]] * metric.PATIENCE]
    assert metric.converged(flat) and not metric.converged([*flat, 0.98 * flat[-1]])


def test_a_correction_is_held_for_ten_samples() -> None:
    class Counting:
        calls = 0

        def correct(self, sample: Sample, age: float) -> Result:
            self.calls += 1
            return Result(1e-4 * self.calls, 0.0, 0.0, 0)  # type: ignore[arg-type]

    inner = Counting()
    made = AtRate(inner)  # type: ignore[arg-type]
    given = [made.correct(Sample(STATE, 0.0, 0.0, 0.0)).delta_u for _ in range(20)]
    assert inner.calls == 2
    assert given == [1e-4] * 10 + [2e-4] * 10


def test_held_out_are_rollouts_of_each_label(model: NetworkModel, monkeypatch: pytest.MonkeyPatch) -> None:
    """Every fourth is unstable, as the gains are drawn: with every fifth held out none or few of them would be."""
    states = np.zeros(1000, STATE_DTYPE)

    def drawn(plant: object, bench: object, settings: object, index: int) -> Rollout:
        return Rollout(states=states, gains=(1.0, 1.0), label=UNSTABLE if index % 4 == 0 else STABLE)

    monkeypatch.setattr(metric, "roll_out", drawn)
    monkeypatch.setattr(metric, "WINDOWS", 3)
    training, held_out, labels = metric.material(model, 8, 0)
    assert labels == {"stable": 6, "unstable": 2, "neither": 0}
    for part, stable in ((training, 15), (held_out, 3)):
        assert [int(part.stable.sum()), len(part.stable) - int(part.stable.sum())] == [stable, 3]
