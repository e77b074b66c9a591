# SPDX-License-Identifier: Apache-2.0
"""A bench file needs what the recorded channels connect: the table, and what is said where something is missing."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from hydro_bridge.signals import StateArray
from hydro_diagnosis import InputError
from hydro_diagnosis.bench_numbers import (
    NONE,
    PartialBench,
    applies,
    completed,
    knows,
    needed,
    numbers,
    read_bench,
    refuse_missing,
)
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
PRESSURES = ("pressure_a", "pressure_b")
RIGS = {
    "force": ("hydraulic_force", "piston_position"),
    "load": ("load_force", "piston_position"),
    "valve": (*PRESSURES, "piston_position", "valve_current"),
    "no current": (*PRESSURES, "piston_position"),
    "forces": (*PRESSURES, "hydraulic_force"),
}


@pytest.fixture(scope="module")
def recorded(nominal: StateArray) -> dict[str, np.ndarray]:
    names = {name for channels in RIGS.values() for name in channels}
    return {name: nominal[name][1000:4000].astype(np.float64) for name in names}


def residual(recorded: dict[str, np.ndarray], channels: Collection[str], bench: Bench) -> np.ndarray:
    segment = Segment("run", 0.0, 1e-3, {name: recorded[name] for name in channels})
    return Problem([segment], bench, noise=dict.fromkeys(recorded, 1.0)).residual(())


@pytest.mark.parametrize("rig", RIGS)
def test_number_that_is_not_needed_changes_no_residual_and_one_that_is_does(
    rig: str, recorded: dict[str, np.ndarray]
) -> None:
    channels = RIGS[rig]
    asked = set(needed(channels, BENCH))
    at_all = asked | set(NONE) if "moving_mass" in asked else asked
    before = residual(recorded, channels, BENCH)
    others = {name: _moved(name) for name in numbers() if name not in at_all}
    assert others
    np.testing.assert_array_equal(residual(recorded, channels, replace(BENCH, **others)), before)
    for name in at_all:
        after = residual(recorded, channels, replace(BENCH, **{name: _moved(name)}))
        assert not np.array_equal(after, before), name


def _moved(name: str) -> float:
    value = getattr(BENCH, name)
    return float(min(1.1 * value + (1e5 if name == "tank_pressure" else 0.0), Bench.quantities()[name].high))


@pytest.mark.parametrize("rig", RIGS)
def test_equations_read_nothing_that_is_not_known(rig: str, recorded: dict[str, np.ndarray]) -> None:
    channels = RIGS[rig]
    known = completed({name: getattr(BENCH, name) for name in needed(channels, BENCH)})
    assert np.all(np.isfinite(residual(recorded, channels, known)))
    refuse_missing(channels, known)


def test_all_that_is_missing_is_asked_for_at_once() -> None:
    bench = completed({"piston_area": 2e-4, "area_ratio": 0.6})
    with pytest.raises(InputError) as refused:
        refuse_missing(("hydraulic_force", "piston_position", "load_force", *PRESSURES), bench)
    sentence = str(refused.value)
    assert "moving_mass (kg, motion equation), spring_stiffness (N/m, load equation)" in sentence
    assert sentence.endswith("--estimate moving_mass spring_stiffness spring_rest_position")
    assert "piston_area" not in sentence and "bulk_modulus" not in sentence


def test_bench_holds_and_writes_only_what_is_known(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("moving_mass: 95.109\n")
    bench = read_bench(path)
    assert isinstance(bench, PartialBench) and bench.to_mapping() == {"moving_mass": 95.109}
    assert knows(bench, "moving_mass", "viscous_friction") and not knows(bench, "stroke")
    assert bench.viscous_friction == bench.spring_stiffness == 0.0
    assert replace(bench, viscous_friction=3.0).to_mapping() == {"moving_mass": 95.109, "viscous_friction": 3.0}
    with pytest.raises(ValueError, match=r"a bench has bulk_modulus, piston_area, .*, too"):
        Bench.load(path)


def test_causes_that_need_what_is_not_known_are_not_tried() -> None:
    bench = completed({"moving_mass": 1.0})
    acting = {effect.id for effect in LIBRARY if applies(effect, bench)}
    assert {"friction_coulomb", "friction_viscous", "moving_mass", "force_offset"} <= acting
    assert not acting & {"end_cushion", "spring_rest", "spring_stiffness", "backlash"}
