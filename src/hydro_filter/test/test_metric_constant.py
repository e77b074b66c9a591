# SPDX-License-Identifier: Apache-2.0
"""What safety.md claims of the constant metric."""

from __future__ import annotations

from dataclasses import replace
from itertools import product

import numpy as np
import pytest

from hydro_filter.metric.constant import (
    ConstantMetric,
    MetricDesign,
    constant_metric,
    contraction_rate,
    gain_floor,
    loop_matrix,
    loop_weight,
)
from hydro_sim.model.bench import Bench

GAINS, POSITIONS, DELAYS = (45.0, 90.0), (0.0, 0.08), (1.3e-3, 1.65e-3)


def test_every_corner_of_gain_stroke_and_delay_contracts(bench: Bench) -> None:
    weight = loop_weight(bench, MetricDesign())
    for gain, position, delay in product(GAINS, POSITIONS, DELAYS):
        matrix = loop_matrix(bench, position=position, proportional_gain=gain, loop_delay=delay)
        assert contraction_rate(weight, matrix) >= 0.1


def test_without_delay_the_loop_is_unstable_from_the_documented_gain(bench: Bench) -> None:
    def slowest(gain: float) -> float:
        matrix = loop_matrix(bench, position=0.04, proportional_gain=gain, loop_delay=0.0)
        return float(np.linalg.eigvals(matrix).real.max())

    edge = bench.viscous_friction / bench.moving_mass
    assert slowest(0.98 * edge) < 0.0 < slowest(1.02 * edge)


def test_metric_is_definite_with_the_documented_condition_number(bench: Bench) -> None:
    matrix = constant_metric(bench).matrix(np.zeros(8))
    eigenvalues = np.linalg.eigvalsh(matrix)
    assert eigenvalues[0] >= 0.0099
    assert eigenvalues[-1] / eigenvalues[0] <= 150.0


def test_gain_floor_is_the_documented_one(bench: Bench) -> None:
    assert gain_floor(constant_metric(bench).matrix(np.zeros(8)), 0.1) == pytest.approx(0.68, abs=0.005)


def test_a_loop_that_does_not_decay_has_no_metric(bench: Bench) -> None:
    with pytest.raises(ValueError, match="does not decay"):
        loop_weight(bench, replace(MetricDesign(), loop_delay=1e-5, proportional_gain=90.0))


@pytest.mark.parametrize("matrix", [np.eye(3), -np.eye(8), np.diag([np.nan] * 8), np.triu(np.ones((8, 8)))])
def test_an_impossible_metric_is_refused(matrix: np.ndarray) -> None:
    with pytest.raises(ValueError, match="metric"):
        ConstantMetric(matrix)
