# SPDX-License-Identifier: Apache-2.0
"""The half-line of the certificate: the paper's formula, its sign, its scale, its noise floor."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_bridge.signals import FloatArray
from hydro_filter.certificate.continuous import Certificate, dead_zone
from hydro_filter.controller.filter import ContractionFilter
from hydro_filter.metric.constant import gain_floor
from hydro_filter.model.dynamics import Linearization
from hydro_filter.model.sample import Sample
from hydro_sim.model.bench import Bench
from hydro_sim.model.hydraulics import input_gain


class VaryingMetric:
    """Positive definite, with a rate, to see every term of the formula."""

    def __init__(self) -> None:
        rng = np.random.default_rng(5)
        root, turn = rng.normal(size=(8, 8)), rng.normal(size=(8, 8))
        self._matrix, self._rate = root @ root.T + np.eye(8), turn + turn.T

    def matrix(self, state: FloatArray) -> FloatArray:
        return self._matrix

    def rate(self, state: FloatArray, state_rate: FloatArray) -> FloatArray:
        return self._rate


class DrawnDynamics:
    """A and B without a zero."""

    def linearize(self, state: FloatArray, current: float) -> Linearization:
        rng = np.random.default_rng(int(1e6 * state[6]))
        return Linearization(rng.normal(size=(8, 8)), rng.normal(size=8), rng.normal(size=8))


@pytest.fixture(scope="module")
def certificate(bench: Bench) -> Certificate:
    return ContractionFilter.for_bench(bench).certificate


def sample(state: FloatArray, *, error: float, gain: float, current: float = 0.002) -> Sample:
    return Sample(state, current, float(state[2] + error), gain)


def test_half_line_is_the_papers_formula(certificate: Certificate, states: FloatArray) -> None:
    """Against dense matrix algebra on normalized states, for any v and a metric that changes."""
    certificate = replace(certificate, metric=VaryingMetric(), dynamics=DrawnDynamics())
    scale, rng = certificate.scale, np.random.default_rng(0)
    for state in states:
        at, v = sample(state, error=50.0, gain=-20.0), rng.normal(size=8)
        linear, law = certificate.dynamics.linearize(state, 0.002), certificate.controller.gradient(at)
        m, m_rate = certificate.metric.matrix(state), certificate.metric.rate(state, linear.state_rate)
        a_matrix, b_vector = linear.state_matrix * scale / scale[:, None], linear.input_vector / scale
        closed = a_matrix + np.outer(b_vector, law * scale)
        product = m @ closed
        m_c = v @ (m_rate + product + product.T + 2 * 0.1 * m) @ v
        line = certificate.evaluate(at, v)
        assert line.b == pytest.approx(-m_c, rel=1e-10)
        assert line.a == pytest.approx(2 * v @ m @ b_vector, rel=1e-10)


def test_constant_metric_bounds_the_proportional_gain_from_below(certificate: Certificate, states: FloatArray) -> None:
    """safety.md: M_c = 2 M_31 (kappa - K_p) (e / 300 N)^2, whatever the state."""
    matrix = certificate.metric.matrix(states[0])
    floor = gain_floor(matrix, 0.1)
    for state in states:
        for gain in (-40.0, floor, 90.0):
            m_c = -certificate.evaluate(sample(state, error=100.0, gain=gain)).b
            assert m_c == pytest.approx(2 * matrix[2, 0] * (floor - gain) / 9.0, rel=1e-9, abs=1e-12)


def test_smallest_correction_lifts_the_gain_to_its_floor(bench: Bench, states: FloatArray) -> None:
    """delta_u = (kappa - K_p) e / g: as if the law had been run with the floor, and towards the reference."""
    contraction_filter = ContractionFilter.for_bench(bench)
    floor = gain_floor(contraction_filter.certificate.metric.matrix(states[0]), 0.1)
    for state, error in zip(states, (-40.0, 40.0) * 100, strict=True):
        g = input_gain(bench.constants()[0], state[6], state[4], state[5], 0.002)
        if g < contraction_filter.certificate.controller.gain_floor:
            continue
        result = contraction_filter.correct(sample(state, error=error, gain=-30.0))
        assert result.delta_u == pytest.approx((floor + 30.0) * error / g, rel=1e-5)
        assert result.delta_u * error > 0.0
        assert result.before > 0.0
        assert result.after == pytest.approx(0.0, abs=1e-6)


def test_errors_within_the_noise_are_none(certificate: Certificate, states: FloatArray) -> None:
    for error in (0.0, 1e-300, 0.5, -1.79, 1.79):
        assert certificate.evaluate(sample(states[0], error=error, gain=-40.0)) == (0.0, 0.0)


def test_dead_zone_is_smooth_odd_and_gone_at_twice_the_floor() -> None:
    errors = np.linspace(-8.0, 8.0, 160_001)
    passed = np.array([dead_zone(error, 1.8) for error in errors])
    np.testing.assert_allclose(passed, -passed[::-1], atol=1e-12)
    slope = np.diff(passed) / np.diff(errors)
    assert np.abs(np.diff(slope)).max() <= 1e-3  # no kink: steps of 0.1 mN
    np.testing.assert_array_equal(passed[np.abs(errors) >= 3.6], errors[np.abs(errors) >= 3.6])
    assert np.isnan(dead_zone(np.nan, 1.8))
