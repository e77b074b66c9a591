# SPDX-License-Identifier: Apache-2.0
"""What has no name is modelled, by what holds on recordings that nothing was fitted to; and only then."""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hydro_diagnosis import diagnose
from hydro_diagnosis.cli import run
from hydro_diagnosis.closure import admission
from hydro_diagnosis.closure.admission import admit, share_closed
from hydro_diagnosis.closure.selection import ClosureFit, closures
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.estimation.fit import Fit, fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.report_json import ClosureReport
from hydro_sim.model.bench import Bench
from tests.segments import frame, problem_in, problem_of, record

BENCH = Bench.nominal()


def test_a_clean_recording_has_no_closure(problem: Problem) -> None:
    nothing = fit(problem, ())
    assert list(closures(problem, nothing)) == []


def held(**errors: float) -> dict[str, object]:
    return {"holdout": {name: {"rmse_after": one, "noise_floor": 1.0} for name, one in errors.items()}}


def test_what_makes_one_channel_worse_is_refused_however_much_it_closes_of_the_others(
    problem: Problem, monkeypatch: pytest.MonkeyPatch
) -> None:
    named, closed = held(a=10.0, b=1.5), ClosureFit(fit(problem, ()), "law", 1.0, problem)
    assert share_closed(named, held(a=1.0, b=1.6)) > 0.9
    for later, taken in ((1.6, False), (float("nan"), False), (1.5, True)):
        monkeypatch.setattr(admission, "holdout_errors", lambda *_, b=later: held(a=1.0, b=b))
        assert (admit(problem, problem, [closed], named) is not None) == taken


def test_a_diagnosis_models_what_has_no_name_and_its_corrected_bench_is_the_bench(tmp_path: Path) -> None:
    truth = replace(BENCH, closures=(entry("motion", "quadratic drag", coefficient=400.0),))
    files = [tmp_path / f"{seed}.csv" for seed in (1, 2, 3)]
    for seed, file in enumerate(files, 1):
        frame(record(truth, seed)).to_csv(file, index=False)
    assert run([*(str(file) for file in files), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == "modelled" and report["effects"] == []
    (term,) = report["closures"]
    assert (term["equation"], term["form"]) == ("motion", "law") and term["share_closed"] > 0.95
    low, high = term["terms"]["coefficient"]["ci95"]
    assert low <= 400.0 <= high and term["terms"]["coefficient"]["unit"] == "N s2/m2"
    position = report["fit"]["holdout"]["piston_position"]
    assert position["rmse_after"] < 1.1 * position["noise_floor"]
    assert position["rmse_named"] > 2.0 * position["rmse_after"]
    corrected = Bench.load(tmp_path / "out" / "corrected.yaml")
    assert corrected.closures[0]["form"] == "quadratic drag" and corrected.digest != BENCH.digest
    again = diagnose([files[2]], bench=corrected)
    assert again.report.verdict == "no_mismatch"
    twice = replace(again, report=replace(again.report, closures=[ClosureReport(**term)] * 2))
    assert str(twice).lower().count("close") == 1, "what all terms close together is said once"


NAMES = {effect.label: effect.adapted(Bench.nominal()) for effect in LIBRARY if effect.named}


def entry(equation: str, form: str, **numbers: float) -> dict[str, Any]:
    return {"equation": equation, "form": form, "parameters": numbers}


DRY = {"id": "friction_coulomb", "parameters": {"force": 8.0}}
OFFSET = {"id": "valve_offset", "parameters": {"current": 2.5e-4}}
RELIEF = entry("pressure_a", "rising leak of A", coefficient=3.5e-13, threshold=6.3e6)
FORM = "closure:motion:quadratic drag"


def values_of(found: Fit) -> dict[str, Mapping[str, float]]:
    return {claim.effect.label: claim.values for claim in found.claims}


LIKELY = [NAMES[label] for label in ("valve_offset", "valve_gain", "leakage_internal", "leakage_external:a",
                                     "bulk_modulus")]  # fmt: skip


@pytest.mark.study
def test_name_and_law_are_handed_back_though_the_judgement_claims_no_name() -> None:
    problem = problem_of(closures=(RELIEF,), effects=(OFFSET,))
    nothing = fit(problem, ())
    found = next(closures(problem, nothing, LIKELY))
    values = values_of(found.fit)
    assert set(values) == {"valve_offset", "closure:pressure_a:rising leak of A"}
    assert values["valve_offset"]["current"] == pytest.approx(2.5e-4, rel=0.01)
    assert values["closure:pressure_a:rising leak of A"]["coefficient"] == pytest.approx(3.5e-13, rel=0.02)
    assert values["closure:pressure_a:rising leak of A"]["threshold"] == pytest.approx(6.3e6, rel=0.005)
    assert not found.problem.noticeable(found.fit.residual)


def test_a_law_that_leaves_nothing_alone_gets_no_name() -> None:
    problem = problem_of(closures=(RELIEF,))
    nothing = fit(problem, ())
    found = next(closures(problem, nothing, LIKELY))
    assert set(values_of(found.fit)) == {"closure:pressure_a:rising leak of A"}


def test_a_name_that_the_judgement_does_not_claim_is_found_beside_a_law() -> None:
    drag = entry("motion", "quadratic drag", coefficient=600.0)
    rubbed = problem_in(record(replace(BENCH, closures=(drag,), effects=(DRY,)), 3))
    nothing = fit(rubbed, ())
    names = [NAMES[label] for label in ("friction_viscous", "friction_coulomb", "moving_mass")]
    law = next(closures(rubbed, nothing, names))
    values = values_of(law.fit)
    assert set(values) == {FORM, "friction_coulomb"}
    assert values["friction_coulomb"]["force"] == pytest.approx(8.0, rel=0.05)
    assert values[FORM]["coefficient"] == pytest.approx(600.0, rel=0.02)
    assert law.form == "law" and not law.problem.noticeable(law.fit.residual)
    # dry friction leaves its sign in doubt: there, not in the judgement
    assert rubbed.uncertainty != law.problem.uncertainty
