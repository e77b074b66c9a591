# SPDX-License-Identifier: Apache-2.0
"""Cases drawn from a seed: each kind alone, beside one and beside two named causes, and with noise; and clean ones.

Each is recorded twice.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.beyond_the_table.kinds import KINDS, NAMES, Kind
from benchmarks.beyond_the_table.named import Values, named_causes
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.box import PERIOD
from benchmarks.foreign_truth.plant import NONE, FloatArray, run
from benchmarks.foreign_truth.recordings import FORCE_NOISE, PRESSURE_NOISE, QUANTUM, RUNS, reference, write_bag

SECONDS = 25.0
SUBSTEPS = 100
"""Steps of the plant in a millisecond."""
CHANNELS = (0, 2, 4, 5)
"""Columns that the ladder's noise is added to: forces and pressures."""

NAMED: dict[str, tuple[str, float, float]] = {
    "valve_gain": ("valve_gain", 0.93, 0.97),
    "valve_offset": ("valve_offset", 1.5e-4, 3e-4),
    "leakage_internal": ("leak_internal", 4e-14, 9e-14),
    "bulk_modulus": ("bulk_modulus", 1.2e9, 1.28e9),
    "friction_coulomb": ("coulomb", 5.0, 10.0),
    "moving_mass": ("moving_mass", 1.32, 1.45),
    "spring_hardening": ("spring_cubic", 3e6, 6e6),
    "load_cell_gain": ("load_cell_gain", 1.02, 1.04),
}
"""Cause of the table: its number in the plant, and the range that it is drawn from."""
LADDER = (40, 30, 20, 10)
"""dB, signal over noise in the logged forces and pressures."""
CLEAN_EVERY = 4


@dataclass(frozen=True)
class Case:
    """One concealed truth."""

    name: str
    kind: Kind | None
    size: float = 0.0
    truth: dict[str, float] = field(default_factory=dict)
    named: tuple[str, ...] = ()
    decibels: int | None = None
    seed: int = 0
    causes: dict[str, Values] = field(default_factory=dict)
    """Of the half `named`: the true values by parameter, by cause."""


def drawn(half: str, count: int, seed: int, kinds: list[str] | None = None) -> list[Case]:
    """The first cases of a half, of these kinds only if any are given; a longer list begins with the shorter one.

    Rounds go through the kinds: alone, beside one named cause, beside two, then alone at each step of the noise ladder.
    After every fourth case comes one in which nothing is missing.
    """
    if half == "named":
        return [
            Case(name, None, truth=truth, named=tuple(causes), seed=int(_random(name, seed).integers(1 << 30)),
                 causes=causes)
            for name, (truth, causes) in named_causes().items()
        ][:count]  # fmt: skip
    chosen = [kind for kind in KINDS if kind.half == half and (not kinds or kind.name in kinds)]
    if not chosen:
        return []
    cases: list[Case] = []
    place = 0
    while len(cases) < count:
        if len(cases) % (CLEAN_EVERY + 1) == CLEAN_EVERY:
            cases.append(_clean(len(cases) // (CLEAN_EVERY + 1), half, seed))
            continue
        cases.append(_outside(chosen[place % len(chosen)], place // len(chosen), seed))
        place += 1
    return cases


def _random(name: str, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


def _clean(number: int, half: str, seed: int) -> Case:
    name = f"clean_{half}_{number}"
    return Case(name, None, seed=int(_random(name, seed).integers(1 << 30)))


def _outside(kind: Kind, around: int, seed: int) -> Case:
    name = f"{kind.name}_{around}"
    random = _random(name, seed)
    size = float(np.exp(random.uniform(*np.log(kind.size))))
    turn, again = around % (3 + len(LADDER)), int(random.integers(1 << 30))
    decibels = LADDER[turn - 3] if turn >= 3 else None
    named = tuple(random.choice(list(NAMED), turn if turn < 3 else 0, replace=False).tolist())
    truth = {NAMED[cause][0]: float(random.uniform(*NAMED[cause][1:])) for cause in named}
    return Case(name, kind, size, truth, named, decibels, again)


def simulated(case: Case, number: int, seconds: float = SECONDS) -> FloatArray:
    """Log of the case's run of this number, shape (n, LOGGED)."""
    wanted, gain = list(RUNS.items())[number]
    count, random = round(seconds / PERIOD), np.random.default_rng([case.seed, number])
    noise = np.array([FORCE_NOISE, FORCE_NOISE, PRESSURE_NOISE, PRESSURE_NOISE]) * random.standard_normal((count, 4))
    physics = NONE if case.kind is None else (NAMES.index(case.kind.name), case.size, case.kind.shape)
    log = run(
        numbers(**case.truth), reference(wanted, count, case.seed + number), gains=(gain, 15.0), noise=noise,
        quantum=QUANTUM, start=6e6 + 4e5 * number, substeps=SUBSTEPS, physics=physics,
    )  # fmt: skip
    if case.decibels is not None:
        for column in CHANNELS:
            log[:, column] += 10.0 ** (-case.decibels / 20.0) * log[:, column].std() * random.standard_normal(count)
    return log


def recorded(case: Case, folder: Path, seconds: float = SECONDS) -> list[Path]:
    """The case's two bags in a folder: the first is fitted, the second, of another class of reference, held out."""
    paths = []
    for number, wanted in enumerate(RUNS):
        path = folder / wanted
        write_bag(path, simulated(case, number, seconds))
        paths.append(path)
    return paths
