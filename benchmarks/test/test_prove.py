# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmarks.prove import __main__ as prove
from benchmarks.prove.__main__ import run
from benchmarks.prove.cases import FITTED, HELD, PARTS, Case, draw
from benchmarks.prove.scores import Result, failures, standards
from hydro_bridge.bags.recording import read_bag
from hydro_core.cli.console import UserError
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


def test_held_out_recording_is_of_a_class_that_is_not_fitted() -> None:
    for case in draw(40, SEED):
        fitted = {case.schedules[name]["waveform"] for name in FITTED}
        assert len(fitted) == 2
        assert case.schedules[HELD]["waveform"] not in fitted


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
    "subprocess.run(['cc', *blind.FLAGS, '--version'], capture_output=True)": True,
    "open(hidden / 'blind' / 'bench.yaml').read()": True,
    "os.listdir(hidden / 'blind')": True,
    "importlib.import_module('hydro_sim.model.hydraulics')": True,
}
PEEKING = """
import importlib, json, os, pathlib, subprocess, sys
from benchmarks.prove import blind
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


def test_forecast_is_scored_against_what_was_recorded() -> None:
    said = answer("explained", "valve_gain", places={"actuation": 1.0})
    forecast = {"rmse_recorded": 8.0, "rmse_corrected": 7.6, "rmse_bench_file": None}
    said["report"]["forecast"] = [forecast]
    one = result(single(valve_gain={"ratio": 1.1}), said)
    assert one.forecast_errors == pytest.approx((0.05, float("inf")))
    rows = {row["standard"]: row for row in standards([one]).rows}
    assert rows["forecast of the RMSE in closed loop, error, median"]["reached"] == "5.0% (bench file: inf%)"


@pytest.mark.study
def test_proof_opens_its_own_seal_and_answers_of_another_version_are_made_again(tmp_path: Path) -> None:
    words = ["--cases", "2", "--seed", str(SEED), "--jobs", "2", "--out", str(tmp_path / "proof")]
    run(words)
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
    answers[0].write_text(json.dumps(json.loads(answers[0].read_text()) | {"engine": "another"}))
    written = [path.stat().st_mtime_ns for path in answers]
    run(words)
    assert [path.stat().st_mtime_ns == before for path, before in zip(answers, written, strict=True)] == [False, True]
