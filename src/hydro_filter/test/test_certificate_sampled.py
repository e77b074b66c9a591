# SPDX-License-Identifier: Apache-2.0
"""The sampled certificate is what it says: two samples moved on, and the smallest current that restores it."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_filter.certificate import qp, sampled
from hydro_filter.model.coordinates import LOOP
from hydro_filter.model.loop import loop_of, step_of
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench

T = 1e-3


def test_the_quadratic_is_two_samples_moved_on() -> None:
    step = step_of(loop_of(load_model(), Bench.nominal()))
    rng = np.random.default_rng(0)
    for _ in range(100):
        root = rng.standard_normal((LOOP, LOOP))
        metric = root @ root.T
        step.transition[:], step.push[:] = rng.standard_normal((LOOP, LOOP)), rng.standard_normal(LOOP)
        step.feedback[:] = rng.standard_normal(LOOP)
        v, known, asked = rng.standard_normal(LOOP), rng.standard_normal(), rng.standard_normal()
        one, two = np.empty(LOOP), np.empty(LOOP)
        bent, slope, level, size = sampled.quadratic(step, metric, v, known, asked, 3.0, one, two)
        moved = step.transition @ v + step.push * (step.feedback @ v + known)
        assert size == pytest.approx(moved @ metric @ moved)
        for change in (0.0, 0.7, -2.0):
            last = step.transition @ moved + step.push * (step.feedback @ moved + asked + change)
            wanted = last @ metric @ last - np.exp(-6.0 * T) * moved @ metric @ moved
            assert bent * change**2 + 2.0 * slope * change + level == pytest.approx(wanted, rel=1e-9, abs=1e-9)


def test_the_half_line_gives_the_smallest_du_of_the_interval() -> None:
    rng = np.random.default_rng(1)
    for _ in range(2000):
        bent, slope = 10.0 ** rng.uniform(-6, 6), rng.standard_normal() * 10.0 ** rng.uniform(-6, 6)
        level = slope**2 / bent * rng.uniform(-2.0, 1.0)  # with an answer
        a, b, _ = sampled.half_line(bent, slope, level)
        change, _ = qp.closed_form(a, b, -1e15, 1e15)
        left = bent * change**2 + 2.0 * slope * change + level
        assert left <= 1e-9 * abs(level)
        if level > 0.0:
            nearer = 0.999 * change
            assert bent * nearer**2 + 2.0 * slope * nearer + level > 0.0


def test_where_no_du_helps_the_nearest_is_told() -> None:
    a, b, best = sampled.half_line(1.0, 1.0, 2.0)
    assert np.isnan(a)
    assert np.isnan(b)
    assert best == -1.0
