# SPDX-License-Identifier: Apache-2.0
"""The learned metric: definite whatever its weights, its rate exact, and the same in torch."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import torch

from hydro_bridge.signals import FloatArray
from hydro_filter import metric_loss
from hydro_filter.learned_metric import LearnedMetric
from hydro_filter.loop_model import loop_model
from hydro_filter.metric_design import MetricDesign
from hydro_filter.metric_loss import Samples
from hydro_filter.metric_network import INPUTS
from hydro_filter.metric_training import network_of, table_rows
from hydro_filter.state import STATES
from hydro_sim.bench import Bench
from hydro_sim.learned.model import Learned
from hydro_sim.learned.weights import WeightsError

GAINS = (12.0, 47.3, 90.0, -20.0, 300.0)


@pytest.fixture(scope="module")
def metric(bench: Bench) -> LearnedMetric:
    """Solved metrics with a network of random weights of some size on top."""
    solved = LearnedMetric.designed(loop_model(Learned.load().model, bench), bench, MetricDesign())
    return solved.with_weights(0.2 * np.random.default_rng(3).standard_normal(solved.flat.shape))


def rates(states: FloatArray) -> FloatArray:
    return np.random.default_rng(5).standard_normal(states.shape) * np.array([3e3, 3e4, 3e3, 3e4, 2e7, 2e7, 0.2, 2.0])


def test_it_is_symmetric_and_definite_whatever_the_weights_are(metric: LearnedMetric, states: FloatArray) -> None:
    for size in (0.0, 1.0, 30.0):
        wild = metric.with_weights(size * np.random.default_rng(1).standard_normal(metric.flat.shape))
        for gain in GAINS:
            for x in states[:20]:
                matrix = wild.matrix(x, gain)
                np.testing.assert_array_equal(matrix, matrix.T)
                smallest, largest = np.linalg.eigvalsh(matrix)[[0, -1]]
                assert smallest > 0.5 * wild.floor - 1e-14 * largest


def test_its_rate_is_the_derivative_along_the_flow(metric: LearnedMetric, states: FloatArray) -> None:
    h = 1e-7
    for x, rate in zip(states[:50], rates(states), strict=False):
        for gain in GAINS:
            _, turn = metric.matrix_and_rate(x, rate, gain)
            difference = (metric.matrix(x + h * rate, gain) - metric.matrix(x - h * rate, gain)) / (2.0 * h)
            np.testing.assert_allclose(turn, difference, rtol=1e-5, atol=1e-6 * np.abs(turn).max())


def test_compiled_and_torch_agree(metric: LearnedMetric, states: FloatArray) -> None:
    for gain in GAINS:
        outside = not metric.gains[0] <= gain <= metric.gains[-1]
        gains, flow = np.full(len(states), gain), rates(states)
        inputs, nudge = np.zeros((len(states), INPUTS)), np.zeros((len(states), INPUTS))
        inputs[:, :STATES], nudge[:, :STATES] = (states - metric.center) / metric.scale, flow / metric.scale
        inputs[:, STATES], inputs[:, STATES + 1] = 0.0 if outside else gain / 100.0, float(outside)
        base = torch.from_numpy(table_rows(metric, gains, outside=outside))
        nothing = torch.zeros(1)
        samples = Samples(torch.from_numpy(inputs), torch.from_numpy(nudge), base, *[nothing] * 4)
        with torch.no_grad():
            matrices, turns = metric_loss.matrices(network_of(metric), samples, metric.floor)
        for k in range(len(states)):
            matrix, turn = metric.matrix_and_rate(states[k], flow[k], gain)
            np.testing.assert_allclose(matrices[k].numpy(), matrix, rtol=1e-9, atol=1e-11)
            np.testing.assert_allclose(turns[k].numpy(), turn, rtol=1e-8, atol=1e-9)


def test_save_load(metric: LearnedMetric, states: FloatArray, tmp_path: Path) -> None:
    given = replace(metric, training={"command": "learn_metric"})
    given.save(tmp_path / "metric.safetensors")
    loaded = LearnedMetric.load(tmp_path / "metric.safetensors")
    assert loaded.training == given.training
    assert loaded.thresholds == given.thresholds
    for gain in GAINS:
        np.testing.assert_array_equal(loaded.matrix(states[0], gain), given.matrix(states[0], gain))


def test_a_learned_bench_is_no_metric() -> None:
    from hydro_sim.learned.weights import shipped

    with pytest.raises(WeightsError, match="not a metric's"):
        LearnedMetric.load(shipped())
