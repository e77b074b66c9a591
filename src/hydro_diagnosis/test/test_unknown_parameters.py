# SPDX-License-Identifier: Apache-2.0
"""Numbers that a bench file need not have, and those that are estimated: values, intervals, causes beside them."""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import replace
from pathlib import Path

import numpy as np
import pandas as pd
import pytest
import yaml

from hydro_core.signals import StateArray
from hydro_diagnosis import Diagnosis, InputError, diagnose
from hydro_diagnosis.bench_parameters import (
    OPTIONAL_PARAMETERS,
    applies,
    bench_parameter_names,
    parse_bench,
    read_bench,
    require_parameters,
    required_parameters,
)
from hydro_diagnosis.cli import run
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.recording import Segment
from hydro_sim.model.bench import NOMINAL, Bench
from tests.segments import frame, record

BENCH = Bench.nominal()
MASS, DRY, VISCOUS, REST = 37.0, 9.0, 40.0, 0.08


def drive(path: Path, stiffness: float = 0.0) -> Path:
    """Force and position of a carriage without a load, written apart from the diagnosis; 12 s at 1 kHz."""
    time, travel = np.arange(12000) * 1e-3, 0.02
    x, v, a = np.full_like(time, 2.5 * travel), np.zeros_like(time), np.zeros_like(time)
    for share, omega, phase in ((0.6, 4.1, 0.0), (0.3, 11.3, 1.0), (0.1, 26.7, 2.0)):
        x += travel * share * np.sin(omega * time + phase)
        v += travel * share * omega * np.cos(omega * time + phase)
        a -= travel * share * omega**2 * np.sin(omega * time + phase)
    rng = np.random.default_rng(5)
    force = MASS * a + VISCOUS * v + DRY * np.sign(v) + stiffness * (x - REST) + rng.normal(0.0, 0.2, len(time))
    x = x + rng.normal(0.0, 1e-7, len(time))
    pd.DataFrame({"time": time, "hydraulic_force": force, "piston_position": x}).to_csv(path, index=False)
    return path


def causes(found: Diagnosis) -> dict[str, float]:
    return {effect.id: next(iter(effect.parameters.values())).value for effect in found.report.effects}


def holds(found: Diagnosis, name: str, truth: float) -> bool:
    one = next(one for one in found.report.estimated if one.name == name)
    assert one.ci95 is not None, one.sentence
    return one.ci95[0] <= truth <= one.ci95[1]


def test_bench_of_one_number_and_no_load_is_diagnosed_and_written(tmp_path: Path) -> None:
    (tmp_path / "bench.yaml").write_text(f"moving_mass: {MASS}\n")
    recording = str(drive(tmp_path / "run.csv"))
    assert run([recording, "--bench", str(tmp_path / "bench.yaml"), "--out", str(tmp_path), "--quiet"]) == 0
    corrected = yaml.safe_load((tmp_path / "corrected.yaml").read_text())
    assert set(corrected) == {"moving_mass", "viscous_friction", "effects"}
    assert corrected["moving_mass"] == MASS
    assert corrected["viscous_friction"] == pytest.approx(VISCOUS, rel=0.03)
    assert [one["id"] for one in corrected["effects"]] == ["friction_coulomb"]
    again = diagnose([recording], bench=tmp_path / "corrected.yaml")
    assert again.report.verdict == "no_mismatch"
    assert any("no spring" in note for note in again.report.data_quality)


def test_unknown_mass_is_estimated_beside_dry_friction_and_what_no_equation_reads_left_open(tmp_path: Path) -> None:
    wanted = ["bulk_modulus", "moving_mass"]
    found = diagnose([drive(tmp_path / "run.csv")], bench={"viscous_friction": VISCOUS}, estimate=wanted)
    assert found.report.verdict == "explained"
    assert causes(found) == {"friction_coulomb": pytest.approx(DRY, rel=0.02)}
    assert holds(found, "moving_mass", MASS)
    modulus, mass = found.report.estimated
    assert (mass.unit, mass.given) == ("kg", None)
    assert modulus.ci95 is None and "too little" in modulus.sentence
    assert found.corrected.moving_mass == mass.value
    assert found.corrected.to_mapping().keys() == {"moving_mass", "viscous_friction", "effects"}


def test_number_that_looks_like_a_cause_says_so(tmp_path: Path) -> None:
    """A spring's rest position and a constant force are one in a motion equation alone."""
    path = drive(tmp_path / "run.csv", stiffness=3000.0)
    bench = {"moving_mass": MASS, "viscous_friction": VISCOUS, "spring_stiffness": 3000.0}
    found = diagnose([path], bench=bench, estimate=["spring_rest_position"])
    rest = found.report.estimated[0]
    assert holds(found, "spring_rest_position", REST)
    assert "force_offset" in rest.alike
    assert "provided that" in rest.sentence and "force_offset" not in causes(found)


@pytest.mark.parametrize("name", ["stroke", "mass"])
def test_number_without_an_effect_is_refused_with_those_that_have_one(name: str, tmp_path: Path) -> None:
    with pytest.raises(InputError, match=f"'{name}'.*moving_mass.*spring_rest_position"):
        diagnose([tmp_path / "none.csv"], estimate=[name])


@pytest.mark.slow
def test_unknown_parameters_of_a_cylinder_beside_a_hidden_leak(tmp_path: Path) -> None:
    leak = {"id": "leakage_internal", "parameters": {"coefficient": 1e-12}}
    hidden = {"dead_volume_a": 2.6e-4, "moving_mass": 1.5}
    frame(record(replace(BENCH, **hidden, effects=(leak,)), 7)).to_csv(tmp_path / "run.csv", index=False)
    known = {key: value for key, value in BENCH.to_mapping().items() if key not in hidden}
    found = diagnose([tmp_path / "run.csv"], bench=known, estimate=list(hidden))
    assert causes(found) == {"leakage_internal": pytest.approx(1e-12, rel=0.02, abs=0.0)}
    assert all(holds(found, name, value) for name, value in hidden.items())
    assert type(Bench.from_mapping(found.corrected.to_mapping())) is Bench


PRESSURES = ("pressure_a", "pressure_b")
RIGS = {
    "force": ("hydraulic_force", "piston_position"),
    "load": ("load_force", "piston_position"),
    "valve": (*PRESSURES, "piston_position", "valve_current"),
    "no current": (*PRESSURES, "piston_position"),
    "forces": (*PRESSURES, "hydraulic_force"),
}


@pytest.mark.parametrize("rig", RIGS)
def test_equations_read_the_parameters_that_are_required_and_no_others(
    rig: str, nominal: StateArray, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(Bench, "size", NOMINAL)  # the machine's size scales the floors of the noise, not the equations

    def residual(bench: Bench) -> np.ndarray:
        recorded = {name: nominal[name][1000:4000].astype(np.float64) for name in RIGS[rig]}
        noise = dict.fromkeys((*PRESSURES, "hydraulic_force", "load_force", "piston_position", "valve_current"), 1.0)
        return Problem([Segment("run", 0.0, 1e-3, recorded)], bench, noise=noise).residual(())

    def moved(names: Collection[str]) -> Bench:
        more = {name: 1.1 * getattr(BENCH, name) + 1e5 * (name == "tank_pressure") for name in names}
        return replace(BENCH, **{name: min(one, Bench.quantities()[name].high) for name, one in more.items()})

    asked = set(required_parameters(RIGS[rig], BENCH))
    known = parse_bench({name: getattr(BENCH, name) for name in asked})
    assert np.all(np.isfinite(residual(known)))
    require_parameters(RIGS[rig], known)
    read = asked | set(OPTIONAL_PARAMETERS) if "moving_mass" in asked else asked
    before = residual(BENCH)
    assert set(bench_parameter_names()) - read
    np.testing.assert_array_equal(residual(moved(set(bench_parameter_names()) - read)), before)
    for name in read:
        assert not np.array_equal(residual(moved([name])), before), name


def test_all_that_is_missing_is_asked_for_at_once() -> None:
    bench = parse_bench({"piston_area": 2e-4, "area_ratio": 0.6})
    with pytest.raises(InputError) as refused:
        require_parameters(("load_force", "piston_position"), bench)
    sentence = str(refused.value)
    assert "spring_stiffness (N/m, load equation), spring_rest_position (m, load equation)" in sentence
    assert sentence.endswith("--estimate spring_stiffness spring_rest_position")
    assert "piston_area" not in sentence and "bulk_modulus" not in sentence
    with pytest.raises(InputError, match=r"--estimate moving_mass$"):  # the cell is at the rod: no spring is needed
        require_parameters(("hydraulic_force", "piston_position", "load_force", *PRESSURES), bench)


def test_bench_without_all_parameters_is_one_of_the_diagnosis_alone(tmp_path: Path) -> None:
    path = tmp_path / "bench.yaml"
    path.write_text("moving_mass: 95.109\n")
    bench = read_bench(path)
    assert bench.to_mapping() == {"moving_mass": 95.109}
    assert replace(bench, viscous_friction=3.0).to_mapping() == {"moving_mass": 95.109, "viscous_friction": 3.0}
    with pytest.raises(ValueError, match=r"a bench has bulk_modulus, piston_area, .*, too"):
        Bench.load(path)


def test_causes_that_need_what_is_not_known_are_not_tried() -> None:
    bench = parse_bench({"moving_mass": 1.0})
    acting = {effect.id for effect in LIBRARY if applies(effect, bench)}
    assert {"friction_coulomb", "friction_viscous", "moving_mass", "force_offset"} <= acting
    assert not acting & {"end_cushion", "spring_rest", "spring_stiffness", "backlash"}
