# SPDX-License-Identifier: Apache-2.0
"""Two bags of a case: the first is fitted, the second, of another class of reference, is held out."""

from __future__ import annotations

from pathlib import Path

import numpy as np

from benchmarks.beyond_the_table.cases import Case
from benchmarks.beyond_the_table.kinds import NAMES
from benchmarks.beyond_the_table.plant import FloatArray, run
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.box import PERIOD
from benchmarks.foreign_truth.recordings import FORCE_NOISE, PRESSURE_NOISE, RUNS, reference, write_bag

SECONDS = 25.0
CHANNELS = (0, 2, 4, 5)
"""Columns that the ladder's noise is added to: forces and pressures."""


def simulated(case: Case, number: int, seconds: float = SECONDS) -> FloatArray:
    """Log of the case's run of this number, shape (n, LOGGED)."""
    wanted, gain = list(RUNS.items())[number]
    count, random = round(seconds / PERIOD), np.random.default_rng([case.seed, number])
    noise = np.array([FORCE_NOISE, FORCE_NOISE, PRESSURE_NOISE, PRESSURE_NOISE]) * random.standard_normal((count, 4))
    place, shape = (-1, 1.0) if case.kind is None else (NAMES.index(case.kind.name), case.kind.shape)
    log = run(numbers(**case.truth), place, case.size, shape, reference(wanted, count, case.seed + number), gain=gain,
              noise=noise, start=6e6 + 4e5 * number)  # fmt: skip
    if case.decibels is not None:
        for column in CHANNELS:
            log[:, column] += 10.0 ** (-case.decibels / 20.0) * log[:, column].std() * random.standard_normal(count)
    return log


def recorded(case: Case, folder: Path, seconds: float = SECONDS) -> list[Path]:
    """The case's two bags in a folder."""
    paths = []
    for number, wanted in enumerate(RUNS):
        path = folder / wanted
        write_bag(path, simulated(case, number, seconds))
        paths.append(path)
    return paths
