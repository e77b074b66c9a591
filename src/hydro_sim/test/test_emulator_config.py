# SPDX-License-Identifier: Apache-2.0
"""The truth's YAML: strict keys, ranges, profiles, and every effect of the contract."""

from __future__ import annotations

from dataclasses import fields
from pathlib import Path
from typing import Any

import pytest
import yaml

from hydro_bridge.settings import SettingsError
from hydro_sim.emulator.line.faults import PRESETS, load_faults
from hydro_sim.emulator.schedules import fit_to
from hydro_sim.emulator.truth.config import load_truth, profile, truth_from_mapping, truth_to_mapping
from hydro_sim.emulator.truth.effects import Effects
from hydro_sim.emulator.truth.outside import Outside
from hydro_sim.emulator.truth.parameters import compile_parameters
from hydro_sim.excitation.schedules import Segment, load_schedule
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING

CONTRACT = set(
    """
    friction_coulomb friction_viscous friction_stribeck leakage_internal leakage_external valve_deadband
    valve_lag transport_delay valve_offset valve_gain valve_gain_asymmetry valve_null_leakage
    supply_droop bulk_modulus entrained_air load_cell_gain load_cell_bias pressure_sensor_bias
    spring_stiffness spring_hardening backlash moving_mass valve_gain_drift end_cushion force_offset
    sensor_lag friction_presliding supply_pressure piston_area area_ratio dead_volume tank_pressure
    spring_rest
    """.split()  # noqa: SIM905
)
"""Effect ids of the diagnosis' table, written down here apart from either implementation."""


def test_every_effect_of_the_contract_can_be_switched_on() -> None:
    assert {field.name for field in fields(Effects)} == CONTRACT


def test_nominal_profile_is_the_shipped_bench() -> None:
    truth = truth_to_mapping(profile("nominal"))
    assert truth["bench"].pop("load_cell_damping") == pytest.approx(LOAD_CELL_DAMPING)
    assert truth["bench"] == Bench.nominal().to_mapping()
    assert truth["effects"] == {}
    assert truth["outside"] == {}


@pytest.mark.parametrize("name", ["nominal", "default"])
def test_truth_survives_the_way_through_yaml(name: str) -> None:
    text = yaml.safe_dump(truth_to_mapping(profile(name)))
    assert truth_from_mapping(yaml.safe_load(text)) == profile(name)


def test_null_turns_an_effect_of_the_profile_off_and_a_mapping_replaces_it() -> None:
    truth = truth_from_mapping(
        {"effects": {"leakage_internal": None, "friction_coulomb": {"force": 20.0, "form": "lugre"}}}
    )
    assert truth.effects.leakage_internal is None
    assert truth.effects.friction_coulomb is not None and truth.effects.friction_coulomb.force == 20.0
    assert truth.effects.valve_lag == profile("default").effects.valve_lag


@pytest.mark.parametrize(
    ("data", "sentence"),
    [
        ({"effect": {}}, "truth.effect is not a known setting; did you mean effects?"),
        ({"effects": {"leakage_internl": {}}}, "did you mean leakage_internal?"),
        ({"effects": {"leakage_internal": {"coefficient": -1}}}, "must be within [0, 1e-10] m3/s/Pa, not -1"),
        ({"effects": {"valve_deadband": {"half_width": 1e-3, "form": "round"}}}, "must be one of hard, soft"),
        ({"effects": {"load_cell_gain": [{"ratio": 1.1}, {"ratio": 1.2}]}}, "names the same cell twice"),
        (
            {"effects": {"friction_presliding": {}, "friction_coulomb": {"form": "static"}}},
            "give friction_coulomb form",
        ),
        ({"effects": {"moving_mass": {"mass": float("nan")}}}, "must be a number in kg, not nan"),
        ({"bench": {"moving_mass": 0.5}, "effects": {"moving_mass": {"mass": -0.5}}}, "takes away all"),
        ({"bench": {"spring_rest_position": 0.09}}, "must lie within the stroke"),
        ({"effects": {"friction_viscous": {"coefficient": -61}}}, "takes away more than all"),
    ],
)
def test_bad_truth_is_refused_in_one_sentence(data: dict[str, Any], sentence: str) -> None:
    with pytest.raises(SettingsError) as caught:
        truth_from_mapping(data)
    assert sentence in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_file_that_is_no_text_is_named(tmp_path: Path) -> None:
    file = tmp_path / "bin.yaml"
    file.write_bytes(b"\xff\xfe\x00\x81")
    with pytest.raises(SettingsError, match=f"^{file} cannot be read: it is no text in UTF-8$"):
        load_truth(file)


@pytest.mark.parametrize("section", ["effects", "outside"])
def test_every_effect_alone_changes_what_the_plant_computes_with(section: str) -> None:
    """No switch is dead: each one changes the numbers that the compiled plant gets."""
    for field in fields(Effects if section == "effects" else Outside):
        other = {"friction_coulomb": {"form": "lugre"}} if field.name == "friction_presliding" else {}
        without = compile_parameters(truth_from_mapping({"profile": "nominal", "effects": other}))
        changes = {section: {**other, field.name: EXAMPLES[field.name]}}
        changed = compile_parameters(truth_from_mapping({"profile": "nominal", **changes}))
        assert changed.tobytes() != without.tobytes(), field.name


EXAMPLES: dict[str, Any] = {
    "friction_coulomb": {}, "friction_viscous": {"coefficient": 10}, "friction_stribeck": {"breakaway_force": 3},
    "friction_presliding": {"stiffness": 4e5}, "leakage_internal": {"coefficient": 1e-12},
    "leakage_external": {"coefficient": 1e-12}, "valve_deadband": {"half_width": 1e-3}, "valve_lag": {},
    "transport_delay": {"time": 1e-3}, "valve_offset": {"current": 1e-4}, "valve_gain": {"ratio": 0.9},
    "valve_gain_asymmetry": {"ratio": 0.9}, "bulk_modulus": {"ratio": 0.9}, "spring_stiffness": {"ratio": 0.9},
    "supply_pressure": {"ratio": 0.9}, "piston_area": {"ratio": 0.9}, "area_ratio": {"ratio": 0.9},
    "dead_volume": {"ratio": 0.9}, "valve_null_leakage": {"coefficient": 1e-9}, "valve_gain_drift": {"rate": 1e-3},
    "supply_droop": {"resistance": 1e9}, "entrained_air": {"volume_fraction": 0.01},
    "load_cell_gain": {"ratio": 1.02}, "load_cell_bias": {"force": 2}, "pressure_sensor_bias": {"pressure": 1e5},
    "sensor_lag": {"bandwidth": 40}, "spring_hardening": {"coefficient": 1e6}, "spring_rest": {"position": 0.041},
    "backlash": {"width": 1e-3}, "moving_mass": {"mass": 0.2}, "end_cushion": {"position": 0.05, "stiffness": 1e4},
    "force_offset": {"force": 5}, "tank_pressure": {"pressure": 1e5}, "friction_rib": {"force": 10},
    "friction_pressure": {"coefficient": 1e-6}, "spring_hysteresis": {"force": 10},
    "valve_temperature": {"change": 0.1}, "valve_underlap": {"half_width": 1e-3},
    "cell_crosstalk": {"coefficient": 1e-6}, "load_hum": {"amplitude": 5}, "load_walk": {"force": 5},
    "wall_flexibility": {"compliance": 1e-14}, "supply_ripple": {"amplitude": 1e5},
}  # fmt: skip


def test_schedule_is_read_strictly_and_fitted(tmp_path: Path) -> None:
    file = tmp_path / "schedule.yaml"
    file.write_text(
        "segments:\n- {seconds: 2, waveform: sine, amplitude: 300, frequency: 0.5, kp: 60}\n- {seconds: 1}\n"
    )
    segments = load_schedule(file)
    assert segments[0] == Segment(seconds=2.0, amplitude=300.0, frequency=0.5, kp=60.0)
    assert [segment.seconds for segment in fit_to(segments, 4.5)] == [2.0, 1.0, 1.5]
    file.write_text("segments:\n- {seconds: 2, wave: sine}\n")
    with pytest.raises(SettingsError, match=r"segments\[0\].wave is not a known setting"):
        load_schedule(file)


def test_faults_are_a_preset_or_a_file(tmp_path: Path) -> None:
    file = tmp_path / "faults.yaml"
    file.write_text("corrupt: 0.1\nevents: [{at: 2, unplug: 1}]\n")
    faults = load_faults(str(file))
    assert (faults.corrupt, faults.events[0].unplug) == (0.1, 1.0)
    assert load_faults("awful") is PRESETS["awful"]
    with pytest.raises(SettingsError, match="neither a file nor one of clean, noisy, awful"):
        load_faults("terrible")
