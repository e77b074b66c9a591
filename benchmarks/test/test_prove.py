# SPDX-License-Identifier: Apache-2.0
"""Sealed cases stay sealed, and the scores count what is right."""

from __future__ import annotations

import json
import subprocess
import sys
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import pytest
import yaml

from benchmarks.prove import __main__ as prove
from benchmarks.prove.cases import FITTED, HELD, PARTS, Case, draw
from benchmarks.prove.scores import Result, failures, standards
from hydro_bridge.bags.recording import read_bag
from hydro_core.cli.console import UserError
from hydro_sim.model.bench import Bench

SEED = 4  # of development; no figure is reported from it
REFUSED = {"report": None, "refused": "no motion", "wall": 1.0, "cpu": 1.0, "engine": "x"}
LEAK = {"leakage_internal": {"coefficient": 1e-13}}
GAIN = {"valve_gain": {"ratio": 1.1}}


def answer(verdict: str, *effects: str, places: Mapping[str, float] | None = None, **parameters: Any) -> dict[str, Any]:
    """What `blind` writes, as far as the scores read it; an effect may have its cell behind its name."""
    named = [one.partition(" ") for one in effects]
    claims = [{"id": id, "options": {"cell": cell} if cell else {}, "parameters": parameters} for id, _, cell in named]
    location = [{"equation": name, "share": share} for name, share in (places or {}).items()]
    holdout = {"load_force": {"rmse_before": 9.0, "rmse_after": 0.9, "noise_floor": 0.6}}
    report = {"verdict": verdict, "effects": claims, "location": location, "fit": {"holdout": holdout}}
    return {**REFUSED, "report": report, "refused": None}


def result(effects: Mapping[str, Mapping[str, Any]], said: Mapping[str, Any]) -> Result:
    kind = ("clean", "single", "pair")[len(effects)]
    return Result(case=Case(name="case-000", kind=kind, label="x", effects=dict(effects)), answer=said)


def test_held_out_recording_is_of_a_class_that_is_not_fitted() -> None:
    for case in draw(40, SEED):
        fitted = {case.schedules[name]["waveform"] for name in FITTED}
        assert len(fitted) == 2 and case.schedules[HELD]["waveform"] not in fitted


def test_seal_opens_to_the_same_answers_and_not_after_a_change(tmp_path: Path) -> None:
    cases, sealed = draw(8, SEED), tmp_path / "sealed"
    digest = prove.seal(cases, sealed)
    assert prove.seal(draw(8, SEED), sealed) == digest and prove.unseal(sealed, digest) == cases
    with pytest.raises(UserError, match="other cases"):
        prove.seal(draw(8, SEED + 1), sealed)
    answers = sealed / prove.ANSWERS
    answers.chmod(0o600)
    answers.write_text(answers.read_text().replace("case-003", "case-004"))
    with pytest.raises(UserError, match="changed after it was sealed"):
        prove.unseal(sealed, digest)


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
    "subprocess.run(['cc', *blind.COMPILER_FLAGS, '--version'], capture_output=True)": True,
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


COULOMB, LUGRE = {"friction_coulomb": {"force": 9.0}}, {"friction_coulomb": {"force": 9.0, "form": "lugre"}}
OFFSETS, ELSEWHERE = (
    {"force_offset": {"force": 9.0}, "load_cell_bias": {"force": 4.0, "cell": cell}}
    for cell in ("load_force", "hydraulic_force")
)
NULL = {"valve_deadband": {"half_width": 3e-4}, "valve_offset": {"current": 1e-4}}


@pytest.mark.parametrize(("truth", "claims", "exact"), [
    ({}, (), True),
    ({}, ("valve_gain",), False),
    (LEAK, ("leakage_internal",), True),
    (LEAK, ("leakage_internal", "valve_gain"), False),
    (LEAK, (), False),
    ({**LEAK, "moving_mass": {"mass": 0.5}}, ("leakage_internal",), False),
    (LUGRE, ("friction_coulomb", "friction_presliding"), True),
    (COULOMB, ("friction_coulomb", "friction_presliding"), False),
    (OFFSETS, ("spring_rest", "force_offset"), True),
    (OFFSETS, ("spring_rest", "load_cell_bias load_force"), True),
    (OFFSETS, ("spring_rest", "load_cell_bias hydraulic_force"), False),
    (OFFSETS, ("spring_rest",), False),
    (ELSEWHERE, ("spring_rest", "force_offset"), False),
    (NULL, ("valve_deadband",), True),
    (NULL, ("valve_offset",), False),
])  # fmt: skip
def test_naming_counts_if_nothing_else_is_claimed_and_names_of_the_same_bench_are_all_right(
    truth: dict[str, Any], claims: tuple[str, ...], exact: bool
) -> None:
    found = result(truth, answer("explained" if claims else "no_mismatch", *claims))
    assert found.exact is found.passed is exact


def test_other_claims_doubt_about_a_clean_bench_and_refusals_are_failures() -> None:
    assert result(LEAK, answer("explained", "leakage_internal", "valve_gain")).spurious == ["valve_gain"]
    assert not result({}, answer("unknown")).passed
    for kind in PARTS:
        case = Case(name="case-000", kind=kind, label="x", effects={} if kind == "clean" else {"valve_gain": {}})
        refused = Result(case=case, answer=REFUSED)
        assert not refused.passed and failures([refused])[0]["why"] == "no motion"


@pytest.mark.parametrize(("said", "passed"), [
    (answer("unknown", places={"motion": 0.95, "load": 0.05}), True),
    (answer("unknown", places={"motion": 0.8, "load": 0.2}), False),
    (answer("partly_explained", "friction_coulomb", places={"motion": 1.0}), False),
    (answer("unknown"), False),
])  # fmt: skip
def test_outside_cause_must_be_called_unknown_in_its_own_equation(said: dict[str, Any], passed: bool) -> None:
    rib = Case(name="case-000", kind="outside", label="friction_rib", outside={"friction_rib": {"force": 5.0}})
    assert Result(case=rib, answer=said).passed is passed


def test_estimates_are_scored_against_the_truth() -> None:
    def estimates(value: float, ci95: list[float] | None) -> list[Any]:
        coefficient = {"value": value, "ci95": ci95, "unit": ""}
        return result(LEAK, answer("explained", "leakage_internal", coefficient=coefficient)).estimates

    (near,), (far,) = estimates(1.01e-13, [0.99e-13, 1.03e-13]), estimates(1.2e-13, [1.1e-13, 1.3e-13])
    assert near.error == pytest.approx(0.01) and near.inside and not far.inside
    assert estimates(1.2e-13, None) == []
    force = {"value": 9.0, "ci95": [8.0, 10.0], "unit": ""}
    assert result(OFFSETS, answer("explained", "spring_rest", "force_offset", force=force)).estimates == []


def test_errors_that_diverge_are_not_forgotten() -> None:
    one = result(GAIN, answer("explained", "valve_gain", places={"actuation": 1.0}))
    assert one.held_out == pytest.approx(1.5)
    report = one.answer["report"]
    report["fit"]["holdout"]["load_force"]["rmse_after"] = None
    report["forecast"] = [{"rmse_recorded": 8.0, "rmse_corrected": 7.6, "rmse_bench_file": None}]
    assert one.forecast_errors == pytest.approx((0.05, float("inf")))
    rows = {row["standard"]: row for row in standards([one] * 3).rows}
    held_out = rows["held-out error over noise floor, 95th percentile"]
    assert (held_out["reached"], held_out["met"]) == ("inf", "no")
    assert rows["forecast of the RMSE in closed loop, error, median"]["reached"] == "5.0% (bench file: inf%)"


@pytest.mark.study
def test_proof_opens_its_own_seal_and_answers_of_another_version_are_made_again(tmp_path: Path) -> None:
    folder = tmp_path / "proof"
    words = ["--cases", "2", "--seed", str(SEED), "--jobs", "2", "--out", str(folder)]
    prove.run(words)
    for case in draw(2, SEED):
        for name in (*FITTED, HELD):
            bag = read_bag(folder / "blind" / case.name / name)
            assert set(bag.attachments) == {"bench.yaml"} and len(bag.state) == 20_000
            assert yaml.safe_load(bag.attachments["bench.yaml"]) == Bench.nominal().to_mapping()
    content = json.loads((folder / "proof.json").read_text())
    assert content["about"]["SHA-256"] == (folder / "sealed" / prove.DIGEST).read_text().split()[0]
    assert [(case["case"], case["passed"]) for case in content["cases"]] == [("case-000", True), ("case-001", True)]
    assert "data:image/png" in (folder / "proof.html").read_text()
    answers = [folder / "blind" / f"case-00{number}" / "answer.json" for number in range(2)]
    answers[0].write_text(json.dumps(json.loads(answers[0].read_text()) | {"engine": "another"}))
    written = [path.stat().st_mtime_ns for path in answers]
    prove.run(words)
    assert [path.stat().st_mtime_ns == before for path, before in zip(answers, written, strict=True)] == [False, True]
