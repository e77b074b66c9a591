# SPDX-License-Identifier: Apache-2.0
"""A damaged recording is refused in a sentence or gets a report: no stage fails."""

from __future__ import annotations

import numpy as np
import pandas as pd
import pytest

from benchmarks.fuzz_recordings import MUTATIONS, mutated, outcome

STEP, SECONDS, BENCH = 1e-2, 30.0, {"moving_mass": 1000.0}


def boom() -> pd.DataFrame:
    """Ramps of a boom of 30 kN whose weight falls with the position, with dry friction."""
    rng, time = np.random.default_rng(0), np.arange(0.0, SECONDS, STEP)
    position = 0.37 + 0.06 * np.interp(time % 8.0, [0.0, 1.0, 3.0, 4.0, 5.0, 7.0, 8.0], [0, 0, 1, 1, 1, 0, 0])
    position += 1e-6 * rng.standard_normal(len(time))
    force = 3e4 - 2e4 * (position - 0.37) + 3e3 * np.sign(np.round(np.gradient(position, STEP), 3))
    return pd.DataFrame(
        {"time": time, "piston_position": position, "hydraulic_force": force + 50.0 * rng.standard_normal(len(time))}
    )


@pytest.mark.parametrize("seed", range(12))
def test_mutated_recording_loses_no_stage(seed: int) -> None:
    data, names = mutated(boom(), seed)
    said, lost = outcome(data, BENCH)
    assert said != "lost", (names, *lost)


def test_every_mutation_changes_the_recording() -> None:
    for name, mutate in MUTATIONS.items():
        changed = [not mutate(boom(), np.random.default_rng(seed)).equals(boom()) for seed in range(8)]
        assert any(changed), name
