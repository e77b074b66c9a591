# SPDX-License-Identifier: Apache-2.0
"""The scheduled metric: definite whatever its table holds, between its gains, and its file, old and new."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_filter.metric.scheduled import ScheduledMetric
from hydro_sim.files import weights

GAINS = (12.0, 47.3, 90.0, -20.0, 300.0)


def test_it_is_symmetric_and_definite_whatever_the_table_holds() -> None:
    rng, metric = np.random.default_rng(1), ScheduledMetric.load()
    for size in (0.0, 1.0, 30.0):
        wild = replace(metric, table=size * rng.standard_normal(metric.table.shape))
        for gain in GAINS:
            matrix = wild.matrix(gain)
            np.testing.assert_array_equal(matrix, matrix.T)
            smallest, largest = np.linalg.eigvalsh(matrix)[[0, -1]]
            assert smallest > 0.5 * wild.floor - 1e-14 * largest


def test_factors_are_interpolated_and_other_gains_have_the_last() -> None:
    metric = ScheduledMetric.load()
    for gain in GAINS:
        inside = metric.gains[0] <= gain <= metric.gains[-1]
        entries = [np.interp(gain, metric.gains, column) for column in metric.table[:-1].T]
        lower = np.zeros((8, 8))
        lower[np.tril_indices(8)] = entries if inside else metric.table[-1]
        np.testing.assert_allclose(metric.matrix(gain), lower @ lower.T + metric.floor * np.eye(8), rtol=1e-12)


def test_save_load_and_the_files_of_earlier_versions(tmp_path: Path) -> None:
    given, path = replace(ScheduledMetric.load(), training={"command": "learn_metric"}), tmp_path / "m.safetensors"
    given.save(path)
    tensors, header = weights.load(path)
    last = {"w3": np.zeros((64, 36)), "b3": np.zeros(36), "center": np.zeros(8)}
    weights.save(path, {**tensors, **last}, {**header, "hidden": [64, 64]})
    loaded = ScheduledMetric.load(path)
    assert loaded.training == given.training
    assert loaded.thresholds == given.thresholds
    for gain in GAINS:
        np.testing.assert_array_equal(loaded.matrix(gain), given.matrix(gain))
    last["b3"][7] = 0.1
    weights.save(path, {**tensors, **last}, header)
    with pytest.raises(weights.WeightsError, match=r"has a network on top of its table.*make it anew with `learn_met"):
        ScheduledMetric.load(path)
