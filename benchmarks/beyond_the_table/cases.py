# SPDX-License-Identifier: Apache-2.0
"""Cases drawn from a seed: each kind alone, beside one and beside two named causes, and with noise; and clean ones.

The half `named` is what the table names, on the same plant: causes alone, four pairs, friction with a Stribeck rise.
Each case is recorded twice.
"""

from __future__ import annotations

import zlib
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from benchmarks.beyond_the_table.kinds import KINDS, NAMES, Kind
from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.equations import PERIOD
from benchmarks.foreign_truth.plant import NOISE, NONE, QUANTUM, RUNS, FloatArray, reference, run, write_bag

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

Values = dict[str, float]
SINGLE: dict[str, tuple[Values, str, Values]] = {
    "valve_deadband": ({"valve_overlap": 3e-4}, "valve_deadband", {"half_width": 3e-4}),
    "valve_lag": ({"spool_bandwidth": 90.0}, "valve_lag", {"bandwidth": 90.0, "damping": 0.8}),
    "valve_offset": ({"valve_offset": 2e-4}, "valve_offset", {"current": 2e-4}),
    "valve_gain": ({"valve_gain": 0.95}, "valve_gain", {"ratio": 0.95}),
    "asymmetry": ({"valve_asymmetry": 0.94}, "valve_gain_asymmetry", {"ratio": 0.94}),
    "transport_delay": ({"valve_delay": 1.3e-3}, "transport_delay", {"time": 1.3e-3}),
    "supply_droop": ({"droop_resistance": 1.5e10, "droop_time": 0.04}, "supply_droop",
                     {"resistance": 1.5e10, "time_constant": 0.04}),
    "supply_pressure": ({"supply_pressure": 15.5e6}, "supply_pressure", {"ratio": 15.5 / 16.0}),
    "bulk_modulus": ({"bulk_modulus": 0.93 * 1.34e9}, "bulk_modulus", {"ratio": 0.93}),
    "entrained_air": ({"air": 0.006}, "entrained_air", {"volume_fraction": 0.006}),
    "leakage_internal": ({"leak_internal": 6e-14}, "leakage_internal", {"coefficient": 6e-14}),
    "leakage_a": ({"leak_a": 4e-14}, "leakage_external a", {"coefficient": 4e-14}),
    "leakage_b": ({"leak_b": 5e-14}, "leakage_external b", {"coefficient": 5e-14}),
    "friction_coulomb": ({"coulomb": 8.0}, "friction_coulomb", {"force": 8.0}),
    "friction_viscous": ({"viscous_friction": 85.0}, "friction_viscous", {"coefficient": 25.0}),
    "moving_mass": ({"moving_mass": 1.35}, "moving_mass", {"mass": 0.15}),
    "spring_hardening": ({"spring_cubic": 4e6}, "spring_hardening", {"coefficient": 4e6}),
    "backlash": ({"backlash": 2e-4}, "backlash", {"width": 2e-4}),
    "load_cell_gain": ({"load_cell_gain": 1.03}, "load_cell_gain load_force", {"ratio": 1.03}),
    "load_cell_bias": ({"load_cell_bias": 4.0}, "load_cell_bias load_force", {"force": 4.0}),
    "gauge_a_bias": ({"gauge_a_bias": -5e4}, "pressure_sensor_bias a", {"pressure": -5e4}),
    "gauge_b_bias": ({"gauge_b_bias": 4e4}, "pressure_sensor_bias b", {"pressure": 4e4}),
    "dead_volume_a": ({"dead_volume_a": 2.2e-4}, "dead_volume a", {"ratio": 1.1}),
    "spring_stiffness": ({"spring_stiffness": 19400.0}, "spring_stiffness", {"ratio": 0.97}),
    "spring_rest": ({"spring_rest_position": 0.0404}, "spring_rest", {"position": 0.0404}),
    "area_ratio": ({"area_ratio": 0.98 * 0.609}, "area_ratio", {"ratio": 0.98}),
    "tank_pressure": ({"tank_pressure": 2e5}, "tank_pressure", {"pressure": 2e5}),
    "force_offset": ({"force_offset": 5.0}, "force_offset", {"force": 5.0}),
    "end_cushion": ({"cushion_stiffness": 8e3, "cushion_position": 0.046}, "end_cushion end",
                    {"stiffness": 8e3, "position": 0.046}),
    "valve_gain_drift": ({"valve_gain_drift": -2e-3}, "valve_gain_drift", {"rate": -2e-3}),
}  # fmt: skip
"""By case: fields of `Numbers` that differ from bench.yaml, the cause (id and the part that it names), its values."""
PAIRS = (("leakage_internal", "friction_coulomb"), ("valve_offset", "spring_hardening"),
         ("entrained_air", "friction_viscous"), ("valve_deadband", "valve_lag"))  # fmt: skip
STRIBECK = ((8.0, 6.0, 0.012), (8.0, 6.0, 0.04), (0.0, 8.0, 0.012), (8.0, 4.0, 0.02), (10.0, 5.0, 0.02),
            (5.0, 4.0, 0.03), (0.0, 6.0, 0.03), (12.0, 8.0, 0.015), (6.0, 3.0, 0.05), (15.0, 10.0, 0.01))  # fmt: skip
"""Level and rise [N], velocity [m/s]."""


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
            name = f"clean_{half}_{len(cases) // (CLEAN_EVERY + 1)}"
            cases.append(Case(name, None, seed=int(_random(name, seed).integers(1 << 30))))
            continue
        cases.append(_outside(chosen[place % len(chosen)], place // len(chosen), seed))
        place += 1
    return cases


def named_causes() -> dict[str, tuple[Values, dict[str, Values]]]:
    """Of each case: what differs, and what must be named."""
    made = {name: (truth, {cause: values}) for name, (truth, cause, values) in SINGLE.items()}
    for pair in PAIRS:
        truths, causes = zip(*(made[name] for name in pair), strict=True)
        made["+".join(pair)] = truths[0] | truths[1], causes[0] | causes[1]
    for level, rise, velocity in STRIBECK:
        told: dict[str, Values] = {"friction_stribeck": {"breakaway_force": rise, "velocity": velocity}}
        told |= {"friction_coulomb": {"force": level}} if level else {}
        truth = {"coulomb": level, "stribeck": rise, "stribeck_velocity": velocity}
        made[f"stribeck_{level:g}_{rise:g}_{1e3 * velocity:g}"] = truth, told
    return made


def _random(name: str, seed: int) -> np.random.Generator:
    return np.random.default_rng([seed, zlib.crc32(name.encode())])


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
    physics = NONE if case.kind is None else (NAMES.index(case.kind.name), case.size, case.kind.shape)
    log = run(
        numbers(**case.truth), reference(wanted, count, case.seed + number), gains=(gain, 15.0),
        noise=NOISE * random.standard_normal((count, 4)), quantum=QUANTUM, start=6e6 + 4e5 * number, substeps=SUBSTEPS,
        physics=physics,
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
