# SPDX-License-Identifier: Apache-2.0
"""The learned metric: definite whatever its weights, and its file. Its rate, and torch: `test_loop_derivatives`."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter.metric.design import MetricDesign
from hydro_filter.metric.learned import LearnedMetric
from hydro_filter.model.loop import loop_of
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

GAINS = (12.0, 47.3, 90.0, -20.0, 300.0)


@pytest.fixture(scope="module")
def metric(bench: Bench) -> LearnedMetric:
    """Solved metrics with a network of random weights of some size on top."""
    solved = LearnedMetric.designed(loop_of(load_model(), bench), bench, MetricDesign())
    return solved.with_weights(0.2 * np.random.default_rng(3).standard_normal(solved.flat.shape))


def test_it_is_symmetric_and_definite_whatever_the_weights_are(metric: LearnedMetric, states: FloatArray) -> None:
    for size in (0.0, 1.0, 30.0):
        wild = metric.with_weights(size * np.random.default_rng(1).standard_normal(metric.flat.shape))
        for gain in GAINS:
            for x in states[:20]:
                matrix = wild.matrix(x, gain)
                np.testing.assert_array_equal(matrix, matrix.T)
                smallest, largest = np.linalg.eigvalsh(matrix)[[0, -1]]
                assert smallest > 0.5 * wild.floor - 1e-14 * largest


def test_save_load(metric: LearnedMetric, states: FloatArray, tmp_path: Path) -> None:
    given = replace(metric, training={"command": "learn_metric"})
    given.save(tmp_path / "metric.safetensors")
    loaded = LearnedMetric.load(tmp_path / "metric.safetensors")
    assert loaded.training == given.training
    assert loaded.thresholds == given.thresholds
    for gain in GAINS:
        np.testing.assert_array_equal(loaded.matrix(states[0], gain), given.matrix(states[0], gain))
