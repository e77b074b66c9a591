# SPDX-License-Identifier: Apache-2.0
"""What has no name is modelled, by what holds on recordings that nothing was fitted to; and only then."""

from __future__ import annotations

import json
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path

import pandas as pd
import pytest

from hydro_bridge.signals import STATE_FIELDS, StateArray, Waveform
from hydro_diagnosis import diagnose
from hydro_diagnosis.cli import run
from hydro_diagnosis.closure.admission import admitted, harmless, reports, share_closed
from hydro_diagnosis.closure.growth import ClosureFit
from hydro_diagnosis.closure.selection import closures
from hydro_diagnosis.effects.base import Claim
from hydro_diagnosis.estimation.fit import fit, noticeable
from hydro_diagnosis.estimation.intervals import intervals
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.recording import Segment
from hydro_diagnosis.selection.verdict import assess
from hydro_diagnosis.validation import held_out
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
DRAG = 400.0


def segment(states: StateArray) -> Segment:
    table = RawTable("run", states["time"].copy(), None, {field: states[field].copy() for field in STATE_FIELDS})
    return checked(table, BENCH).segments[0]


@pytest.fixture(scope="module")
def dragged(record: Callable[..., StateArray]) -> list[Segment]:
    """A bench with 400 N s2/m2 of quadratic drag: one recording to fit, one of another class held out."""
    closure = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": DRAG}}
    truth = replace(BENCH, closures=(closure,))
    return [segment(record(truth, 3)), segment(record(truth, 5, waveform=Waveform.SMOOTH_STEP))]


def test_quadratic_drag_is_a_law_with_its_interval_and_closes_the_gap(dragged: list[Segment]) -> None:
    problem = Problem(dragged[:1], BENCH)
    nothing = fit(problem, ())
    found = list(closures(problem, assess(problem, nothing, nothing)))
    law = found[0]
    assert law.form == "law"
    assert [claim.effect.label for claim in law.fit.claims] == ["closure:motion:quadratic drag"]
    assert not noticeable(problem, law.fit.residual)
    held, models = Problem(dragged[1:], BENCH, noise=problem.sensor_noise), [SegmentModel(dragged[1], BENCH)]
    named = held_out(problem, held, (), models)
    handed = admitted(problem, held, found, models, named)
    assert handed is not None
    assert handed.share > 0.99
    assert (
        handed.held["holdout"]["piston_position"]["rmse_named"]
        > 10 * (handed.held["holdout"]["piston_position"]["rmse_after"])
    )
    (report,) = reports(handed, intervals(problem, law.fit))
    low, high = report.terms["coefficient"].ci95 or [0.0, 0.0]
    assert low <= DRAG <= high
    assert "square of speed" in report.sentence

    pushed = Claim(law.fit.claims[0].effect, {"coefficient": -DRAG})
    worse = ClosureFit(fit(problem, (pushed,), iterations=0), "law", 1.0, problem)
    assert admitted(problem, held, [worse], models, named) is None


def test_a_clean_recording_has_no_closure(problem: Problem) -> None:
    nothing = fit(problem, ())
    assert list(closures(problem, assess(problem, nothing, nothing))) == []


def test_share_closed_counts_what_stands_above_the_noise() -> None:
    def held(**errors: float) -> dict[str, object]:
        return {"holdout": {name: {"rmse_after": one, "noise_floor": 1.0} for name, one in errors.items()}}

    assert share_closed(held(a=3.0, b=1.0), held(a=1.0, b=0.9)) == pytest.approx(1.0)
    assert share_closed(held(a=3.0, b=1.0), held(a=3.0, b=1.0)) == pytest.approx(0.0)
    assert share_closed(held(a=3.0, b=1.0), held(a=3.0, b=2.0)) == pytest.approx(1.0 - 11.0 / 8.0)


def test_what_makes_one_channel_worse_is_refused_however_much_it_closes_of_the_others() -> None:
    def held(**errors: float) -> dict[str, object]:
        return {"holdout": {name: {"rmse_after": one, "noise_floor": 1.0} for name, one in errors.items()}}

    named = held(a=10.0, b=1.5)
    assert share_closed(named, held(a=1.0, b=1.6)) > 0.9
    assert not harmless(named, held(a=1.0, b=1.6))
    assert not harmless(named, held(a=1.0, b=float("nan")))
    assert harmless(named, held(a=1.0, b=1.5))


def test_a_diagnosis_models_what_has_no_name_and_its_corrected_bench_is_the_bench(
    record: Callable[..., StateArray], frame: Callable[[StateArray], pd.DataFrame], tmp_path: Path
) -> None:
    closure = {"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": DRAG}}
    truth = replace(BENCH, closures=(closure,))
    files = [tmp_path / f"{seed}.csv" for seed in (1, 2, 3)]
    for seed, file in enumerate(files, 1):
        frame(record(truth, seed)).to_csv(file, index=False)
    assert run([*(str(file) for file in files), "--out", str(tmp_path / "out"), "--quiet"]) == 0
    report = json.loads((tmp_path / "out" / "report.json").read_text())
    assert report["verdict"] == "modelled" and report["effects"] == []
    (term,) = report["closures"]
    assert (term["equation"], term["form"]) == ("motion", "law") and term["share_closed"] > 0.95
    position = report["fit"]["holdout"]["piston_position"]
    assert position["rmse_after"] < 1.1 * position["noise_floor"]
    assert position["rmse_named"] > 2.0 * position["rmse_after"]
    corrected = Bench.load(tmp_path / "out" / "corrected.yaml")
    assert corrected.closures[0]["form"] == "quadratic drag" and corrected.digest != BENCH.digest
    assert diagnose([files[2]], bench=corrected).report.verdict == "no_mismatch"
