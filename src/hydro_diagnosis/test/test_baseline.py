# SPDX-License-Identifier: Apache-2.0
"""A learned bench as the baseline: a model of the healthy bench, which then wears."""

from __future__ import annotations

import json
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest

from hydro_bridge.bags.recording import BagWriter
from hydro_diagnosis import diagnose
from hydro_diagnosis.cli import run
from hydro_diagnosis.report.corrected_bench import claims_of
from hydro_diagnosis.stages.reading import baseline
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.files.learned_bench import shipped
from hydro_sim.model.bench import Bench

DRIVES = (
    {"seconds": 15, "waveform": "multisine", "amplitude": 260, "frequency": 0.7, "kp": 60, "ki": 10},
    {"seconds": 15, "waveform": "smooth_step", "amplitude": 240, "frequency": 0.8, "kp": 45, "ki": 8},
    {"seconds": 15, "waveform": "sine", "amplitude": 250, "offset": 20, "frequency": 1.1, "kp": 70, "ki": 12},
)
HEALTHY_FRICTION = 12.0
HEALTHY_LEAK = 1e-13


def test_learned_constants_become_the_bench_and_its_effects() -> None:
    believed, origin = baseline(None, shipped())
    assert origin == "learned learned_bench.yaml"
    assert believed.moving_mass == pytest.approx(1.2, rel=5e-3)
    assert believed.load_cell_bandwidth is None
    assert believed.valve_gain == pytest.approx(Bench.nominal().valve_gain, rel=1e-3)
    claims = {claim.effect.id: dict(claim.values) for claim in claims_of(believed)}
    assert claims["valve_lag"]["bandwidth"] == pytest.approx(110.0, rel=1e-2)
    assert claims["friction_coulomb"]["force"] == pytest.approx(HEALTHY_FRICTION, rel=1e-2)
    assert claims["sensor_lag"] == pytest.approx({"bandwidth": 25.0, "damping": 0.55}, rel=5e-3)


@pytest.mark.study
def test_leak_and_friction_are_named_as_changes_and_corrected_as_wholes(tmp_path: Path) -> None:
    """The command's corrected.yaml is a baseline by itself: of the worn bench."""
    wear = {"leakage_internal": {"coefficient": 1e-12}, "friction_coulomb": {"force": 18.0, "form": "lugre"}}
    bags, out = recorded(wear, tmp_path), tmp_path / "report"
    assert run([*map(str, bags), "--model", str(shipped()), "--out", str(out), "--quiet"]) == 0
    report = json.loads((out / "report.json").read_text())
    named = {effect["id"]: next(iter(effect["parameters"].values()))["value"] for effect in report["effects"]}
    expected = {"leakage_internal": 1e-12 - HEALTHY_LEAK, "friction_coulomb": 18.0 - HEALTHY_FRICTION}
    assert named == pytest.approx(expected, rel=0.02)
    corrected = Bench.load(out / "corrected.yaml")
    assert whole(corrected, "leakage_internal", "coefficient") == pytest.approx(1e-12, rel=0.01)
    assert whole(corrected, "friction_coulomb", "force") == pytest.approx(18.0, rel=0.01)
    assert diagnose([bags[2]], bench=corrected).report.verdict == "no_mismatch"


def whole(bench: Bench, effect: str, parameter: str) -> float:
    return sum(float(one["parameters"][parameter]) for one in bench.effects if one["id"] == effect)


def recorded(wear: Mapping[str, Any], folder: Path) -> list[Path]:
    """Three runs of the emulator's default truth with wear: the diagnosis knows no truth plant."""
    truth = truth_from_mapping({"profile": "default", "effects": dict(wear)})
    for k, segment in enumerate(DRIVES):
        with BagWriter(folder / f"run{k}") as writer:
            writer.write_states(record_offline(truth, [Segment(**segment)], seed=50 + k).states)
    return [folder / f"run{k}" for k in range(len(DRIVES))]
