# SPDX-License-Identifier: Apache-2.0
"""The truth's YAML: strict keys, ranges, profiles, and every effect of the contract."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from hydro_bridge.settings import SettingsError
from hydro_sim.emulator.offline import fit_to
from hydro_sim.emulator.truth.config import load_truth, profile, truth_from_mapping, truth_to_mapping
from hydro_sim.excitation.schedules import Segment, load_schedule
from hydro_sim.model.bench import Bench
from hydro_sim.model.equations import LOAD_CELL_DAMPING


def test_nominal_profile_is_the_shipped_bench() -> None:
    truth = truth_to_mapping(profile("nominal"))
    assert truth["bench"].pop("load_cell_damping") == pytest.approx(LOAD_CELL_DAMPING)
    assert truth["bench"] == Bench.nominal().to_mapping()
    assert truth["effects"] == {}
    assert truth["outside"] == {}


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
    with pytest.raises(SettingsError, match=f"^{file} cannot be read: it is not UTF-8 text$"):
        load_truth(file)


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
