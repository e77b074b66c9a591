# SPDX-License-Identifier: Apache-2.0
"""A held-out window that the model itself cannot predict says nothing; a wrong model's error stays."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path

import pytest

from hydro_bridge.signals import Waveform
from hydro_diagnosis.cli import run
from hydro_diagnosis.effects import LIBRARY, Claim
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import sensor_noise
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.stages.reporting import not_predicted
from hydro_diagnosis.validation import HORIZON, MOST, Comparison, compare
from hydro_sim.model.bench import Bench
from tests.segments import frame, problem_in, record, segment

BENCH = Bench.nominal()
RISE = {"breakaway_force": 8.0, "velocity": 0.012}
"""Stribeck friction without any other: the piston stops and breaks loose by tenths of a newton."""


def stribeck(**values: float) -> Claim:
    return Claim(next(one for one in LIBRARY if one.label == "friction_stribeck"), {**RISE, **values})


@pytest.fixture(scope="module")
def held() -> SegmentModel:
    truth = replace(BENCH, effects=({"id": "friction_stribeck", "parameters": RISE},))
    states = record(truth, 11, seconds=25.0, waveform=Waveform.SMOOTH_STEP)
    return SegmentModel(segment(states), BENCH)


def against_nothing(held: SegmentModel, claims: list[Claim]) -> Comparison:
    return compare([held], (), claims, sensor_noise([held]), seconds=HORIZON, windows=48, shooting=True)


def worst(comparison: Comparison, which: str) -> float:
    return max(error[which] / error["noise_floor"] for error in comparison.channels.values())


def test_true_model_is_at_the_noise_where_it_can_predict(held: SegmentModel) -> None:
    found = against_nothing(held, [stribeck()])
    assert found.left_out and len(found.left_out) <= MOST * found.windows
    assert worst(found, "rmse_after") < 1.15 < 3.0 < worst(found, "rmse_after_all")
    assert all(window["recording"] == "run" and 0.0 < window["start"] < 25.0 for window in found.left_out)


@pytest.mark.parametrize("claims", [[], [stribeck(breakaway_force=2.0)]], ids=["no friction", "too little friction"])
def test_error_of_a_wrong_model_stays(held: SegmentModel, claims: list[Claim]) -> None:
    found = against_nothing(held, claims)
    assert worst(found, "rmse_after") > 0.8 * worst(found, "rmse_after_all") > 5.0


SLOW, FAST = 60.0, 300.0
"""Amplitudes of the reference [N]."""


def claims(*names: str) -> list[Claim]:
    effects = [next(one for one in LIBRARY if one.label == name).adapted(BENCH) for name in names]
    return [Claim(one, {number.name: number.probes[0] for number in one.parameters}) for one in effects]


@pytest.mark.parametrize(
    ("truth", "named", "predicted"),
    [
        ({"effects": ({"id": "friction_viscous", "parameters": {"coefficient": 150.0}},)}, ["friction_viscous"], True),
        ({"closures": ({"equation": "motion", "form": "quadratic drag", "parameters": {"coefficient": 1500.0}},)},
         ["friction_viscous"], False),
        ({}, [], True),
    ],
)  # fmt: skip
def test_a_name_that_takes_the_form_of_another_within_what_was_seen_does_not_predict(
    truth: dict[str, Sequence[object]], named: list[str], predicted: bool
) -> None:
    bench = replace(BENCH, **truth)
    fitted, unseen = (problem_in(record(bench, seed, amplitude=size)) for seed, size in ((1, SLOW), (2, FAST)))
    found = fit(fitted, claims(*named))
    unseen = unseen.weighed(found.claims)
    note = not_predicted(unseen, found.claims)
    assert (note == "") == predicted
    assert predicted or "(motion)" in note


@pytest.mark.study
def test_names_that_predict_the_held_out_recordings_worse_than_the_bench_file_are_not_claimed(
    tmp_path: Path,
    capsys: pytest.CaptureFixture[str],
) -> None:  # fmt: skip
    """A drag that was there in one recording and not in the other; what is estimated in any case stays."""
    dragged = replace(BENCH, effects=({"id": "friction_viscous", "parameters": {"coefficient": 300.0}},))
    for name, bench, seed in (("with", dragged, 1), ("without", BENCH, 2), ("again", dragged, 3)):
        frame(record(bench, seed)).to_csv(tmp_path / f"{name}.csv", index=False)
    for held, verdict, names in (("without", "unknown", []), ("again", "explained", ["friction_viscous"])):
        words = [str(tmp_path / "with.csv"), "--holdout", str(tmp_path / f"{held}.csv"), "--quiet"]
        words += ["--estimate", "moving_mass"]
        assert run([*words, "--out", str(tmp_path / held)]) == 0
        report = json.loads((tmp_path / held / "report.json").read_text(encoding="utf-8"))
        assert report["verdict"] == verdict
        assert [effect["id"] for effect in report["effects"]] == names
        assert [number["name"] for number in report["estimated"]] == ["moving_mass"], report["estimated"]
        assert ("  note: friction_viscous would explain" in capsys.readouterr().out) == (held == "without")
        errors = report["fit"]["holdout"].values()
        assert all(error["rmse_after"] <= 1.1 * error["rmse_before"] + error["noise_floor"] for error in errors)
