# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from hydro_bridge.signals import StateArray
from hydro_diagnosis import diagnose
from hydro_diagnosis.corrected import claims_of, corrected_bench
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_sim.bench import Bench

Record = Callable[..., StateArray]
Frame = Callable[[StateArray], pd.DataFrame]
CONTRACT = {
    "verdict", "location", "effects", "fit", "next_recording", "checked", "not_checked", "data_quality", "baseline",
    "versions", "seconds",
}  # fmt: skip


def test_command_writes_what_the_contract_says(written: Path) -> None:
    report = json.loads((written / "report.json").read_text())
    assert set(report) >= CONTRACT
    assert report["verdict"] == "explained"
    assert [effect["id"] for effect in report["effects"]] == ["spring_stiffness"]
    ratio = report["effects"][0]["parameters"]["ratio"]
    assert ratio["ci95"][0] <= 18500.0 / 20000.0 <= ratio["ci95"][1]
    assert report["location"][0]["equation"] == "load"
    assert report["effects"][0]["evidence"]["holdout_gain"] == pytest.approx(1.0, abs=0.05)
    for channel, error in report["fit"]["holdout"].items():
        assert error["rmse_after"] < 1.1 * error["noise_floor"], channel
    assert report["fit"]["holdout"]["load_force"]["rmse_before"] > 5.0


def test_second_diagnosis_with_the_corrected_bench_finds_nothing(worn: list[Path], written: Path) -> None:
    corrected = Bench.load(written / "corrected.yaml")
    assert corrected.spring_stiffness == pytest.approx(18500.0, rel=2e-3)
    again = diagnose([worn[2]], bench=corrected)
    assert again.report.verdict == "no_mismatch"


def test_effects_survive_the_corrected_bench(tmp_path: Path) -> None:
    bench = Bench.nominal()
    claims = [
        Claim(effect.adapted(bench), {one.name: one.probes[0] for one in effect.parameters})
        for effect in LIBRARY
        if effect.id in ("friction_coulomb", "valve_lag", "leakage_external", "sensor_lag")
        and effect.options.get("form") is None
    ]
    back = claims_of(corrected_bench(bench, claims))
    assert [(claim.effect.label, dict(claim.values)) for claim in back] == [
        (claim.effect.label, dict(claim.values)) for claim in claims
    ]


def test_recording_without_pressures_is_diagnosed_for_what_it_shows(
    tmp_path: Path, record: Record, frame: Frame
) -> None:
    truth = replace(Bench.nominal(), viscous_friction=110.0)
    path = tmp_path / "bare.csv"
    frame(record(truth, 31))[["time", "hydraulic_force", "piston_position"]].to_csv(path, index=False)
    report = diagnose([path]).report
    assert [effect.id for effect in report.effects] == ["friction_viscous"]
    assert report.checked == ["motion"]
    assert any("pressure_a" in name for name in report.not_checked)


def test_bad_input_ends_in_one_sentence_and_status_2(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "hydro_diagnosis.cli", str(tmp_path / "none.mcap"), "--out", str(tmp_path)]
    ended = subprocess.run(command, capture_output=True, text=True, check=False)
    assert ended.returncode == 2
    assert len(ended.stderr.strip().splitlines()) == 1
    assert "there is no such recording" in ended.stderr


def test_python_returns_what_the_command_writes(csv: Path, nominal: StateArray) -> None:
    found = diagnose([csv])
    assert found.report.verdict == "no_mismatch"
    assert json.loads(found.report.to_json())["effects"] == []
