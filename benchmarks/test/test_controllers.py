# SPDX-License-Identifier: Apache-2.0
"""Every controller of `benchmarks.controllers` runs, and the compensated law is the best of them."""

from __future__ import annotations

import pytest

from benchmarks.controllers import compensated, load_cases, load_cell, run_one
from hydro_sim.emulator.truth.config import profile

CASES = load_cases(None)[1:2]


def error(name: str) -> float:
    (row,) = run_one(profile("default"), name, CASES)
    assert row["reference"] == "1 Hz" and not row["tripped"]
    return row["rmse"]


@pytest.mark.parametrize("other", ["policy", "paper_fixed", "robust_fixed"])
def test_the_compensated_law_is_far_better_than_what_has_two_gains(other: str) -> None:
    assert error("compensated") < 0.2 * error(other)


def test_with_a_known_cell_the_force_on_the_specimen_follows() -> None:
    config = profile("default")
    (plain,), (known,) = compensated(config, CASES), compensated(config, CASES, cell=load_cell(config))
    assert known["true_rmse"] < 0.2 * plain["true_rmse"] and known["true_rmse"] < 2.0 * plain["rmse"]
