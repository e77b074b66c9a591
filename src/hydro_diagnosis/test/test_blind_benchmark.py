# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.cli.console import UserError
from hydro_diagnosis.blind_benchmark import prove
from hydro_diagnosis.blind_benchmark.cases import FITTED, HELD, PARTS, Case, draw, shares
from hydro_diagnosis.blind_benchmark.prove import run
from hydro_diagnosis.blind_benchmark.recording import ATTEMPTS, record, run_emulator, usable
from hydro_diagnosis.blind_benchmark.scores import Result, failures, standards, wilson
from hydro_sim.model.bench import Bench

SEED = 4  # of development; no figure is reported from it


def answer(
    verdict: str, *effects: str | tuple[str, dict[str, str]], places: dict[str, float] | None = None, **parameters: Any
) -> dict[str, Any]:
    """What `blind` writes, as far as the scores read it."""
    named = [(one, {}) if isinstance(one, str) else one for one in effects]
    claims = [{"id": name, "options": options, "parameters": parameters, "evidence": {"delta_bic": 1e3}}
              for name, options in named]  # fmt: skip
    location = [{"equation": name, "share": share} for name, share in (places or {}).items()]
    holdout = {"load_force": {"rmse_before": 9.0, "rmse_after": 0.9, "noise_floor": 0.6}}
    report = {"verdict": verdict, "effects": claims, "location": location, "fit": {"holdout": holdout}}
    return {"report": report, "refused": None, "wall": 2.0, "cpu": 1.0, "engine": "x"}


def result(case: Case, said: dict[str, Any]) -> Result:
    return Result(case=case, answer=said)


def single(**effects: dict[str, Any]) -> Case:
    kind = {0: "clean", 1: "single", 2: "pair"}[len(effects)]
    return Case(name="case-000", kind=kind, label="x", effects=effects)


@pytest.mark.parametrize("count", [1, 20, 224, 301])
def test_shares_are_all_cases_in_the_proportions_of_the_proof(count: int) -> None:
    parts = shares(count)
    assert sum(parts.values()) == count
    assert all(abs(parts[kind] - count * PARTS[kind] / 224) < 1.0 for kind in PARTS)


def test_drawing_repeats_itself_and_hides_kinds_behind_numbers() -> None:
    cases = draw(60, SEED)
    assert cases == draw(60, SEED)
    assert [case.name for case in cases] == [f"case-{k:03d}" for k in range(60)]
    assert len({case.kind for case in cases[:12]}) > 3
    assert draw(60, SEED + 1) != cases


def test_held_out_recording_is_of_a_class_that_is_not_fitted() -> None:
    for case in draw(40, SEED):
        fitted = {case.schedules[name]["waveform"] for name in FITTED}
        assert len(fitted) == 2
        assert case.schedules[HELD]["waveform"] not in fitted


def test_attempts_ask_for_less_from_one_to_the_next_and_tell_the_box_alone() -> None:
    drawn = {"seconds": 20.0, "waveform": "sine", "amplitude": 250.0, "kp": 70.0, "ki": 4.0}
    assert ATTEMPTS[0].schedule(drawn) == drawn
    assert ATTEMPTS[0].box() is None
    assert ATTEMPTS[1].schedule(drawn) == {**drawn, "amplitude": 150.0, "kp": 30.0}
    believed = [attempt.believed_flow for attempt in ATTEMPTS]
    assert believed == sorted(believed)
    nominal, told = Bench.nominal(), ATTEMPTS[-1].box()
    assert told is not None
    assert replace(told, valve_nominal_flow=nominal.valve_nominal_flow) == nominal


@pytest.mark.study
@pytest.mark.parametrize("effects", [
    {"valve_gain": {"ratio": 1.12}},
    {"supply_pressure": {"ratio": 1.1}, "valve_gain": {"ratio": 1.15}, "piston_area": {"ratio": 0.92}},
])  # fmt: skip
def test_bench_that_trips_is_recorded_again_until_it_runs(effects: dict[str, Any], tmp_path: Path) -> None:
    (case,) = draw(1, SEED)
    schedules = {name: {**one, "seconds": 5.0} for name, one in case.schedules.items()}
    assert record([replace(case, effects=effects, schedules=schedules)], tmp_path, float("inf"))
    for name in (*FITTED, HELD):
        bag = tmp_path / case.name / name
        assert usable(bag)
        assert np.ptp(read_bag(bag).state["piston_position"]) > 2e-3
        told = yaml.safe_load(read_bag(bag).attachments["bench.yaml"])
        assert told["valve_nominal_flow"] > 1.2 * Bench.nominal().valve_nominal_flow


def test_seal_opens_to_the_same_answers_and_not_after_a_change(tmp_path: Path) -> None:
    cases = draw(8, SEED)
    digest = prove.seal(cases, tmp_path / "sealed")
    assert prove.seal(draw(8, SEED), tmp_path / "sealed") == digest
    assert prove.unseal(tmp_path / "sealed", digest) == cases
    with pytest.raises(UserError, match="other cases"):
        prove.seal(draw(8, SEED + 1), tmp_path / "sealed")
    answers = tmp_path / "sealed" / prove.ANSWERS
    answers.chmod(0o600)
    answers.write_text(answers.read_text().replace("case-003", "case-004"))
    with pytest.raises(UserError, match="changed after it was sealed"):
        prove.unseal(tmp_path / "sealed", digest)


PEEKS = {
    "open(hidden / 'sealed' / 'answers.json')": False,
    "(hidden / 'blind' / '..' / 'sealed' / 'answers.json').read_bytes()": False,
    "os.open(hidden / 'sealed' / 'answers.json', os.O_RDONLY)": False,
    "open(hidden / 'blind' / 'link')": False,
    "os.listdir(hidden)": False,
    "list(os.scandir(hidden / 'sealed'))": False,
    "importlib.import_module('hydro_sim.emulator.truth.config')": False,
    "subprocess.run(['cat', hidden / 'sealed' / 'answers.json'])": False,
    "os.system('true')": False,
    "open(hidden / 'blind' / 'bench.yaml').read()": True,
    "os.listdir(hidden / 'blind')": True,
    "importlib.import_module('hydro_sim.model.hydraulics')": True,
}


PEEKING = """
import importlib, json, os, pathlib, subprocess, sys
from hydro_diagnosis.blind_benchmark import blind
hidden = pathlib.Path(sys.argv[1])
blind.guard(hidden, hidden / "blind")
seen = {}
for peek in json.loads(sys.argv[2]):
    try:
        eval(peek)
        seen[peek] = True
    except blind.SealedError:
        seen[peek] = False
print(json.dumps(seen))
"""


def test_blindfolded_process_sees_recordings_and_nothing_else(tmp_path: Path) -> None:
    prove.seal(draw(2, SEED), tmp_path / "sealed")
    (tmp_path / "blind").mkdir()
    (tmp_path / "blind" / "bench.yaml").write_text("{}")
    (tmp_path / "blind" / "link").symlink_to(tmp_path / "sealed" / "answers.json")
    words = [sys.executable, "-c", PEEKING, str(tmp_path), json.dumps(list(PEEKS))]
    done = subprocess.run(words, check=False, capture_output=True, text=True)
    assert json.loads(done.stdout) == PEEKS, done.stderr


def test_naming_counts_only_if_nothing_else_is_claimed() -> None:
    leak = single(leakage_internal={"coefficient": 1e-13})
    assert result(leak, answer("explained", "leakage_internal")).exact
    assert not result(leak, answer("explained", "leakage_internal", "valve_gain")).exact
    assert result(leak, answer("explained", "leakage_internal", "valve_gain")).spurious == ["valve_gain"]
    assert not result(leak, answer("no_mismatch")).exact
    pair = single(leakage_internal={"coefficient": 1e-13}, moving_mass={"mass": 0.5})
    assert not result(pair, answer("explained", "leakage_internal")).exact
    lugre = single(friction_coulomb={"force": 9.0, "form": "lugre"})
    assert result(lugre, answer("explained", "friction_coulomb", "friction_presliding")).exact
    plain = single(friction_coulomb={"force": 9.0})
    assert not result(plain, answer("explained", "friction_coulomb", "friction_presliding")).exact


def test_name_in_the_wrong_chamber_is_wrong() -> None:
    case = single(leakage_external={"coefficient": 1e-13, "chamber": "a"})
    assert result(case, answer("explained", ("leakage_external", {"chamber": "a"}))).exact
    other = result(case, answer("explained", ("leakage_external", {"chamber": "b"})))
    assert not other.exact
    assert other.spurious == ["leakage_external"]


def test_two_names_of_the_same_bench_are_both_right() -> None:
    on_load, on_rod = {"cell": "load_force"}, {"cell": "hydraulic_force"}
    offsets = single(force_offset={"force": 9.0}, load_cell_bias={"force": 4.0, **on_load})
    assert result(offsets, answer("explained", "spring_rest", "force_offset")).exact
    assert result(offsets, answer("explained", "spring_rest", ("load_cell_bias", on_load))).exact
    assert not result(offsets, answer("explained", "spring_rest", ("load_cell_bias", on_rod))).exact
    assert not result(offsets, answer("explained", "spring_rest")).exact
    assert result(offsets, answer("explained", "spring_rest", "force_offset")).estimates == []
    elsewhere = single(force_offset={"force": 9.0}, load_cell_bias={"force": 4.0, **on_rod})
    assert not result(elsewhere, answer("explained", "spring_rest", "force_offset")).exact
    shifted = single(valve_deadband={"half_width": 3e-4}, valve_offset={"current": 1e-4})
    assert result(shifted, answer("explained", "valve_deadband")).exact
    assert not result(shifted, answer("explained", "valve_offset")).exact


@pytest.mark.study
def test_truth_plant_agrees_that_those_benches_are_the_same(tmp_path: Path) -> None:
    ways = {
        "rest": {"spring_rest": {"position": 0.041}},
        "offsets": {"force_offset": {"force": 20.0}, "load_cell_bias": {"force": -20.0, "cell": "load_force"}},
        "shifted": {"valve_deadband": {"half_width": 3e-4}, "valve_offset": {"current": 1e-4}},
        "lopsided": {"valve_deadband": {"half_width": 2e-4, "half_width_negative": 4e-4}},
    }
    jobs, plan = [], tmp_path / "plan.yaml"
    segment = {"seconds": 5.0, "waveform": "multisine", "amplitude": 280.0, "frequency": 0.7, "kp": 60.0, "ki": 10.0}
    plan.write_text(yaml.safe_dump({"segments": [segment]}))
    for name, effects in ways.items():
        truth = tmp_path / f"{name}.yaml"
        truth.write_text(yaml.safe_dump({"profile": "nominal", "effects": effects}))
        jobs.append({"out": str(tmp_path / name), "truth": str(truth), "schedule": str(plan), "seed": 1})
    (tmp_path / "batch.yaml").write_text(yaml.safe_dump({"jobs": jobs}))
    run_emulator(["--offline", "--batch", str(tmp_path / "batch.yaml")])
    recorded = {name: read_bag(tmp_path / name).state for name in ways}
    moving = slice(3000, None)  # the emulator's piston starts at the spring's rest: that is forgotten by then
    for one, other, within in (("rest", "offsets", 1e-3), ("shifted", "lopsided", 1e-6)):
        for field in ("load_force", "hydraulic_force", "piston_position", "pressure_a"):
            apart = (recorded[one][field] - recorded[other][field])[moving]
            assert np.sqrt(np.mean(np.square(apart))) < within * np.ptp(recorded[one][field]), field
    assert np.ptp(recorded["rest"]["load_force"] - recorded["shifted"]["load_force"]) > 1.0


def test_clean_bench_passes_only_without_any_claim_or_doubt() -> None:
    clean = single()
    assert result(clean, answer("no_mismatch")).passed
    assert not result(clean, answer("unknown")).passed
    assert not result(clean, answer("explained", "valve_gain")).passed


def test_refusal_is_a_failure_of_every_kind() -> None:
    refused = {"report": None, "refused": "no motion", "wall": 1.0, "cpu": 1.0, "engine": "x"}
    for kind in PARTS:
        case = Case(name="case-000", kind=kind, label="x", effects={} if kind == "clean" else {"valve_gain": {}})
        assert not result(case, refused).passed
        assert failures([result(case, refused)])[0]["why"] == "no motion"


def test_outside_cause_must_be_called_unknown_in_its_own_equation() -> None:
    rib = Case(name="case-000", kind="outside", label="friction_rib", outside={"friction_rib": {"force": 5.0}})
    assert result(rib, answer("unknown", places={"motion": 0.95, "load": 0.05})).passed
    assert not result(rib, answer("unknown", places={"motion": 0.8, "load": 0.2})).passed
    assert not result(rib, answer("partly_explained", "friction_coulomb", places={"motion": 1.0})).passed
    assert not result(rib, answer("unknown")).passed


def test_estimates_are_scored_against_the_truth() -> None:
    leak = single(leakage_internal={"coefficient": 1e-13})
    near = {"coefficient": {"value": 1.01e-13, "ci95": [0.99e-13, 1.03e-13], "unit": ""}}
    far = {"coefficient": {"value": 1.2e-13, "ci95": [1.1e-13, 1.3e-13], "unit": ""}}
    flat = {"coefficient": {"value": 1.2e-13, "ci95": None, "unit": ""}}
    (one,) = result(leak, answer("explained", "leakage_internal", **near)).estimates
    assert one.error == pytest.approx(0.01)
    assert one.inside
    assert not result(leak, answer("explained", "leakage_internal", **far)).estimates[0].inside
    assert result(leak, answer("explained", "leakage_internal", **flat)).estimates == []


def test_held_out_error_that_diverges_is_not_forgotten() -> None:
    said = answer("explained", "valve_gain", places={"actuation": 1.0})
    case = single(valve_gain={"ratio": 1.1})
    assert result(case, said).held_out == pytest.approx(1.5)
    said["report"]["fit"]["holdout"]["load_force"]["rmse_after"] = None
    rows = {row["standard"]: row for row in standards([result(case, said)] * 3).rows}
    assert rows["held-out error over noise floor, 95th percentile"]["reached"] == "inf"
    assert rows["held-out error over noise floor, 95th percentile"]["met"] == "no"


def test_wilson_interval_agrees_with_the_published_example() -> None:
    low, high = wilson(81, 263)  # Newcombe 1998, table I
    assert low == pytest.approx(0.2553, abs=5e-5)
    assert high == pytest.approx(0.3662, abs=5e-5)
    assert wilson(0, 60)[0] == 0.0


def test_place_that_cannot_be_written_is_found_before_anything_is_sealed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "runs").touch()
    monkeypatch.chdir(tmp_path)
    for words in (["--out", "runs/x"], []):  # by default it is below runs/, too
        with pytest.raises(UserError, match="runs is not a folder: choose another place"):
            run(["--cases", "1", "--seed", "1", *words])
    assert [path.name for path in tmp_path.iterdir()] == ["runs"]


@pytest.mark.slow
def test_proof_goes_on_after_time_was_up_and_opens_its_own_seal(
    tmp_path: Path, capfd: pytest.CaptureFixture[str]
) -> None:
    words = ["--cases", "2", "--seed", str(SEED), "--jobs", "2", "--out", str(tmp_path / "proof")]
    assert run([*words, "--minutes", "0"]) == 3
    assert run(words) == 0
    folder = tmp_path / "proof"
    for case in draw(2, SEED):
        for name in (*FITTED, HELD):
            bag = read_bag(folder / "blind" / case.name / name)
            assert set(bag.attachments) == {"bench.yaml"}
            assert yaml.safe_load(bag.attachments["bench.yaml"]) == Bench.nominal().to_mapping()
            assert len(bag.state) == 20_000
    content = json.loads((folder / "proof.json").read_text())
    assert content["about"]["SHA-256"] == (folder / "sealed" / prove.DIGEST).read_text().split()[0]
    assert len(content["cases"]) == 2
    assert {case["case"]: case["passed"] for case in content["cases"]} == {"case-000": True, "case-001": True}
    assert "data:image/png" in (folder / "proof.html").read_text()
    answers = [folder / "blind" / f"case-00{number}" / "answer.json" for number in range(2)]
    _answer_by_another_version(answers[0])
    written = [path.stat().st_mtime_ns for path in answers]
    capfd.readouterr()
    assert run(words) == 0
    assert [path.stat().st_mtime_ns for path in answers] == written
    assert "another version (another): --again" in capfd.readouterr().err
    assert run([*words, "--again"]) == 0
    assert "another version" not in capfd.readouterr().err
    assert [path.stat().st_mtime_ns == before for path, before in zip(answers, written, strict=True)] == [False, True]


def _answer_by_another_version(path: Path) -> None:
    path.write_text(json.dumps(json.loads(path.read_text()) | {"engine": "another"}))


def test_case_survives_the_seal() -> None:
    for case in draw(24, SEED):
        assert Case.from_mapping(json.loads(json.dumps(case.to_mapping()))) == replace(case, size=case.size)
