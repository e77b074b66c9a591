# SPDX-License-Identifier: Apache-2.0
"""The diagnosis of three machines stays the same in other units, directions and orders."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from benchmarks.invariances import check

STEP = 1e-2
ONLY = ("forces times 0.001", "lengths times 20", "force added", "given twice")


def machine(weight: float, slope: float, dry: float, viscous: float) -> pd.DataFrame:
    """Ramps of several speeds against a weight that changes with the position, and friction; SI units."""
    rng, time = np.random.default_rng(3), np.arange(0.0, 40.0, STEP)
    stroke = np.interp(time % 10.0, [0.0, 0.5, 2.0, 3.0, 6.5, 7.0, 8.5, 10.0], [0, 0, 1, 1, 0, 0, 0.6, 0])
    position = 0.3 + 0.1 * np.convolve(np.pad(stroke, 10, mode="edge"), np.full(21, 1.0 / 21.0), "valid")
    speed = np.gradient(position, STEP)
    force = weight + slope * (position - 0.35) + dry * np.tanh(speed / 1e-3) + viscous * speed
    slow = np.interp(time, np.arange(0.0, 40.0, 0.4), rng.standard_normal(100))  # as threads, seals and hoses add
    noise = 0.05 * dry * (slow + 0.1 * rng.standard_normal(len(time)))
    return pd.DataFrame({"time": time, "piston_position": position + 1e-6 * rng.standard_normal(len(time)),
                         "hydraulic_force": force + noise})  # fmt: skip


@pytest.mark.parametrize(
    ("numbers", "mass"),
    [((31e3, -22e3, 3.7e3, 0.0), 1000.0), ((0.0, 0.0, 70.0, 0.0), 2.0), ((-500.0, 0.0, 300.0, 4000.0), 20.0)],
    ids=("boom", "small cylinder", "damper"),
)
def test_answer_is_the_same_in_other_units(numbers: tuple[float, float, float, float], mass: float) -> None:
    differing = {name: said for name, said in check(machine(*numbers), {"moving_mass": mass}, ONLY).items() if said}
    assert not differing
