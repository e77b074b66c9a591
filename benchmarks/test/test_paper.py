# SPDX-License-Identifier: Apache-2.0
"""`benchmarks.paper`: pieces are kept, the metric's loss is its definition's, the page says what was not run."""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
import torch

from benchmarks.paper import agents, metric, report
from benchmarks.paper.metric import NetworkMetric, PaperFilter
from benchmarks.paper.models import NetworkModel
from benchmarks.paper.store import FULL, OWN_BENCH, PRINTED, RESULTS, Store, truth
from hydro_filter.model.sample import Sample
from hydro_filter.training.data import DataSettings, roll_out
from hydro_policy.evaluation.controllers import FixedGains
from hydro_sim.files.recordings import Run
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant

pytestmark = pytest.mark.study
STATE = np.array([50.0, 100.0, 40.0, 90.0, 6e6, 9.8e6, 0.042, 0.01])
SCALE = np.array([150.0, 1500.0, 150.0, 1500.0, 7e5, 7e5, 7e-3, 7e-2])


@pytest.fixture
def model() -> NetworkModel:
    rng = np.random.default_rng(0)
    x = np.array([0.0, 0.0, 0.0, 0.0, 6e6, 9.8e6, 0.04, 0.0]) + SCALE * rng.standard_normal((400, 8))
    run = Run(name="drawn", first=0, x=x, u=1e-3 * rng.standard_normal(400))
    return NetworkModel.untrained([run], (32, 32), 0)


@pytest.fixture
def network() -> torch.nn.Sequential:
    torch.manual_seed(0)
    sizes = (torch.nn.Linear(8, 64), torch.nn.ReLU(), torch.nn.Linear(64, 64), torch.nn.ReLU(), torch.nn.Linear(64, 36))
    return torch.nn.Sequential(*sizes).double()


@pytest.fixture
def learned(network: torch.nn.Sequential, model: NetworkModel) -> NetworkMetric:
    return NetworkMetric(tuple(p.detach().numpy().T for p in network.parameters()), model.center, model.scale)


def test_the_page_is_made_from_the_results_that_came_with_it(tmp_path: Path) -> None:
    page = (RESULTS.parents[2] / "docs/reports/paper.md").read_text(encoding="utf-8")
    assert page == report.text(Store(tmp_path, FULL, RESULTS))


def test_fixed_gains_have_the_papers_row_on_a_bench_of_its_own(tmp_path: Path) -> None:
    found = agents._rmse(Store(tmp_path, FULL).own, FixedGains(90.0, 15.0), 7)
    np.testing.assert_allclose(found["rmse"], PRINTED["rmse"]["III"], rtol=0.1)
    believed, own = Bench.load(OWN_BENCH), truth("own").bench
    assert all(getattr(own, name) == value for name, value in believed.to_mapping().items())
    assert own.load_cell_bandwidth == 22.0 and truth("default").bench != own


def test_the_networks_slopes_are_its_differences(model: NetworkModel) -> None:
    state_matrix, input_vector, _ = model.linearized(STATE, 1e-3)
    for column, move in enumerate(1e-6 * np.diag(SCALE)):
        up, down = (model.linearized(STATE + sign * move, 1e-3)[2] for sign in (1.0, -1.0))
        slope = (up - down) / (2.0 * move[column])
        np.testing.assert_allclose(state_matrix[:, column], slope, rtol=1e-4, atol=1e-6 * np.abs(slope).max())
    up, down = (model.linearized(STATE, 1e-3 + sign * 1e-9)[2] for sign in (1.0, -1.0))
    np.testing.assert_allclose(input_vector, (up - down) / 2e-9, rtol=1e-4, atol=1e-3)


def test_rollouts_of_another_plant_are_those_of_the_compiled_loop_to_the_bit() -> None:
    plant, bench = AnalyticPlant(Bench.nominal()), Bench.nominal()
    another = SimpleNamespace(reset=plant.reset, step=plant.step)  # no compiled loop knows it, as `NetworkPlant`
    settings = DataSettings(rollouts=2, gain_max=200.0, seconds=2.0)
    compiled, by_samples = (roll_out(one, bench, settings, 1) for one in (plant, another))
    assert compiled.states.tobytes() == by_samples.states.tobytes()
    assert len(compiled.states) == 2000


def test_the_metrics_rate_is_its_difference_along_the_motion(learned: NetworkMetric) -> None:
    motion = 5.0 * SCALE
    value, rate = learned.along(STATE, motion)
    assert np.linalg.eigvalsh(value).min() > 0.0
    up, down = (learned.along(STATE + sign * 1e-6 * motion, motion)[0] for sign in (1.0, -1.0))
    np.testing.assert_allclose(rate, (up - down) / 2e-6, rtol=1e-5, atol=1e-7)


def test_training_and_filter_have_the_same_certificate(
    network: torch.nn.Sequential, learned: NetworkMetric, model: NetworkModel
) -> None:
    paper, sample = PaperFilter(learned, model), Sample(STATE, 1e-3, 90.0, 60.0)
    z, rate, v, closed = (torch.from_numpy(row)[None, None] for row in metric._normalized(sample, model, paper.law))
    grown, _ = metric.growth(network, metric.Samples(z, rate, v, closed, torch.tensor([[True]])))
    assert -paper.certificate(sample)[1] == pytest.approx(float(grown.detach()), rel=1e-9)
