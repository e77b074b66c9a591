# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import numpy as np
from scipy.signal import cont2discrete

from hydro_diagnosis.model.memory import RecordMemory, StepMemory, amplifier
from hydro_diagnosis.preprocessing.smoothing import finish, kinematics


def test_amplifier_equals_scipys_first_order_hold() -> None:
    omega, damping = 2.0 * np.pi * 25.0, 0.6
    reference = cont2discrete(([omega**2], [1.0, 2.0 * damping * omega, omega**2]), 1e-3, method="foh")
    numerator, denominator = amplifier(25.0, damping, 1e-3)
    assert np.allclose(numerator, reference[0][0])
    assert np.allclose(denominator, reference[1])


def test_lag_by_steps_equals_lag_over_a_record() -> None:
    signal = np.random.default_rng(2).normal(size=300)
    record = RecordMemory(1e-3)
    record.lag("x", signal, 0.02)
    steps = StepMemory(1e-3)
    stepped = []
    for value in signal:
        stepped.append(steps.lag("x", np.array([value]), 0.02)[0])
        steps.tick()
    assert np.allclose(stepped, record.traces["x"])


def test_bristle_by_steps_equals_bristle_over_a_record() -> None:
    position = 1e-3 * np.sin(np.arange(2000) * 0.01)
    limit = np.full(2000, 12.0)
    whole = RecordMemory(1e-3).bristle("z", position, 2e5, limit)
    steps = StepMemory(1e-3)
    stepped = []
    for place in position:
        stepped.append(steps.bristle("z", np.array([place]), 2e5, limit[:1])[0])
        steps.tick()
    assert np.allclose(stepped, whole)
    assert np.max(np.abs(whole)) <= 12.0


def test_kinematics_are_exact_on_parabolas() -> None:
    time = np.arange(200) * 1e-3
    x, v, a = kinematics(0.04 + 0.3 * time - 2.0 * time**2, 1e-3)
    inner = slice(20, -20)
    assert np.allclose(a[inner], -4.0)
    assert np.allclose(v[inner], (0.3 - 4.0 * time)[inner])
    assert np.allclose(finish(a)[inner], -4.0)
    assert np.allclose(x[inner], (0.04 + 0.3 * time - 2.0 * time**2 - 2.0 * 1e-6)[inner], atol=1e-9)
