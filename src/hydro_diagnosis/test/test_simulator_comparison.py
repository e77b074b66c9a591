# SPDX-License-Identifier: Apache-2.0
"""Recordings of a simulator beside those of the bench: what differs, and by which numbers."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hydro_diagnosis.cli import run
from hydro_diagnosis.pipeline import diagnose
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.report_json import EffectReport, ParameterEstimate, Rival
from hydro_diagnosis.simulator_comparison import differences, indistinct, sentences
from hydro_diagnosis.stage_bar import SEARCHING
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import Bench
from tests.segments import frame

REAL = {"friction_coulomb": {"force": 12.0}, "valve_lag": {"bandwidth": 100.0, "damping": 0.8},
        "valve_offset": {"current": 3e-4}}  # fmt: skip
SIMULATOR = {"friction_coulomb": {"force": 6.0}, "valve_lag": {"bandwidth": 160.0, "damping": 0.8}}


def recorded(folder: Path, effects: dict[str, Any], noise: float, name: str, **renamed: str) -> list[str]:
    """Two CSV files of a concealed plant; its sensors are ideal where the noise is 0."""
    sensors = {"noise_scale": noise}
    truth = {"profile": "nominal", "bench": Bench.nominal().to_mapping(), "sensors": sensors, "effects": effects}
    paths = []
    for seed, waveform in enumerate(("multisine", "sine")):
        segment = Segment(seconds=7.0, waveform=waveform, amplitude=200.0, frequency=0.7, kp=60.0, ki=10.0)
        states = record_offline(truth_from_mapping(truth), [segment], seed=seed).states
        paths.append(folder / f"{name}{seed}.csv")
        frame(states).rename(columns=renamed).to_csv(paths[-1], index=False)
    return [str(path) for path in paths]


def test_concealed_simulator_is_told_from_the_bench(tmp_path: Path, valid: Callable[[Any], Any]) -> None:
    """Friction and lag of both, each with its own numbers, and a null shift that the simulator has not."""
    bench = recorded(tmp_path, REAL, 1.0, "run")
    simulator = recorded(tmp_path, SIMULATOR, 0.0, "sim", piston_position="x")
    words = ["--simulated", *simulator, "--simulated-columns", "piston_position=x", "--out", str(tmp_path), "--quiet"]
    assert run([*bench, *words]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    valid(report)
    found = {one["id"]: one for one in report["simulated"]}
    only_in = {name: one["only_in"] for name, one in found.items()}
    assert only_in == {"friction_coulomb": None, "valve_lag": None, "valve_offset": "real"}
    for name, key in (("friction_coulomb", "force"), ("valve_lag", "bandwidth")):
        number, real, simulated = found[name]["parameters"][key], REAL[name][key], SIMULATOR[name][key]
        assert number["real"] == pytest.approx(real, rel=0.05)
        assert number["simulated"] == pytest.approx(simulated, rel=0.05)
        assert number["ci95"][0] <= real - simulated <= number["ci95"][1]
    page = (tmp_path / "report.html").read_text()
    assert "Bench and simulator" in page and "the bench has, the simulator has not: valve_offset" in page
    said: list[str] = []
    with pytest.raises(InputError, match=r"none\.csv: there is no such recording"):
        diagnose(bench, simulated=["none.csv"], progress=said.append)
    assert SEARCHING not in said, "before anything is searched for"


def effect(name: str, value: float, half: float, **options: str) -> EffectReport:
    estimate = ParameterEstimate(value=value, ci95=[value - half, value + half], unit="N")
    return EffectReport(id=name, equation="motion", options=options, sentence="x", parameters={"force": estimate},
                        evidence={}, rivals=[], look_alikes=[])  # fmt: skip


def test_numbers_within_each_other_s_doubt_are_no_difference() -> None:
    real = [effect("friction_coulomb", 10.0, 0.3), effect("load_cell_bias", 5.0, 0.1, cell="load_force")]
    same = [effect("friction_coulomb", 10.35, 0.3, form="other"), effect("load_cell_bias", 5.0, 0.1, cell="load_force")]
    assert differences(real, same) == []
    apart = [effect("friction_coulomb", 10.5, 0.3), replace(same[1], options={"cell": "hydraulic_force"})]
    found = differences(real, apart)
    assert [(one.id, one.only_in) for one in found] == [
        ("load_cell_bias", "real"), ("friction_coulomb", None), ("load_cell_bias", "simulated")
    ]  # fmt: skip
    number = found[1].parameters["force"]
    assert number.difference == pytest.approx(-0.5) and number.ci95 == pytest.approx([-0.924, -0.076], abs=1e-3)
    assert "force is 10 N on the bench and 10.5 N in the simulator, -0.5 N" in sentences(found)[1]
    both = [effect("friction_viscous", 10.0, 0.3, form=form) for form in ("linear", "directional")]
    (missing,) = differences(both, both[:1])
    assert missing.options == {"form": "directional"} and missing.only_in == "real"


def test_causes_that_explain_each_other_s_recordings_are_no_difference() -> None:
    """A lag and a dead time on a sine: what the one recording is said to have, the other may have as well."""
    same = effect("friction_coulomb", 10.0, 0.3)
    lag, delay = effect("valve_lag", 120.0, 3.0), effect("transport_delay", 2e-3, 1e-5)
    as_well = Rival(id="valve_lag", delta_bic=0.3, distinguishable=False, why="x")
    worse = replace(as_well, delta_bic=900.0, distinguishable=True)
    real, simulated = [lag, same], [replace(delay, rivals=[as_well]), same]
    assert differences(real, simulated) == []
    assert [(a.id, b.id) for a, b in indistinct(real, simulated)] == [("valve_lag", "transport_delay")]
    assert len(differences(real, [replace(delay, rivals=[worse]), same])) == 2
