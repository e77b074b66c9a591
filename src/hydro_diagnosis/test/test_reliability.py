# SPDX-License-Identifier: Apache-2.0
"""What is read off at steady speed is the truth's, each objection takes `explained` away, a name must predict."""

from __future__ import annotations

import json
from collections.abc import Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import Waveform
from hydro_diagnosis.bench_numbers import completed
from hydro_diagnosis.cli import run
from hydro_diagnosis.effects import Claim
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.intervals import Interval, intervals
from hydro_diagnosis.estimation.problem import Problem, sensor_noise
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.quality import checked
from hydro_diagnosis.selection.steady_motion import FRICTION, curves, missed
from hydro_diagnosis.selection.verdict import seen_at_steady_speed
from hydro_diagnosis.stages.naming import contradicted, differing, moved
from hydro_diagnosis.stages.reporting import explained_shares, not_predicted, objections
from hydro_diagnosis.validation import HORIZON, MOST, Comparison, compare
from hydro_sim.model.bench import Bench
from tests.segments import claim, frame, problem_in, record, segment

DRY = "friction_coulomb"
BENCH = completed({"moving_mass": 1.0}, frozenset())
SPEEDS = (0.02, 0.05, 0.12)


def strokes(force: float, name: str) -> RawTable:
    """A piston pushed out and back at constant speeds against 10 N and 20 N s/m, the cell reads `force` beside."""
    rng, velocity = np.random.default_rng(len(name)), np.repeat([s * v for v in SPEEDS for s in (1.0, -1.0)], 1500)
    position = 0.02 + np.cumsum(velocity) * 1e-3
    time = 1e-3 * np.arange(len(velocity), dtype=np.float64)
    balance = np.sign(velocity) * 10.0 + 20.0 * velocity + force
    columns = {"piston_position": position, "hydraulic_force": balance + 0.1 * rng.standard_normal(len(time))}
    return RawTable(name, time, None, columns)


def problem(*forces: float) -> Problem:
    tables = [strokes(force, f"run{k}") for k, force in enumerate(forces)]
    return Problem([checked(table, BENCH).segments[0] for table in tables], BENCH)


def proof(before: float, after: float) -> dict[str, Any]:
    return {"equations": {"motion": {"rmse_before": before, "rmse_after": after, "noise_floor": 1.0}}}


def test_force_over_steady_speed_is_that_of_the_truth() -> None:
    points = curves(problem(0.0), ())[FRICTION]
    assert len(points) == 2 * len(SPEEDS)
    for point in points:
        assert point.measured == pytest.approx(np.sign(point.at) * 10.0 + 20.0 * point.at, abs=0.1)
        assert point.before == point.model == 0.0


@pytest.mark.parametrize(("size", "off", "refused"), [(11.0, 0, []), (5.0, 6, ["friction_coulomb"])])
def test_a_claim_that_misses_most_steady_speeds_is_told_and_refused(size: float, off: int, refused: list[str]) -> None:
    judged = problem(0.0)
    found = fit(judged, (claim(DRY, size), claim("moving_mass", 0.1)), iterations=0)
    bounds = [Interval(size, size, size, True), Interval(0.1, 0.0, 0.2, True)]
    points = curves(judged, found.claims)[FRICTION]
    assert len(missed(points)) == off
    assert any("at 6 of 6 steady speeds" in one for one in objections(found, bounds, proof(10.0, 0.5), points)) == bool(
        off
    )
    reasons = contradicted(judged, found, [], bounds, points, 0.1, 20.0)
    assert [label for label, reason in reasons.items() if "steady speeds" in reason] == refused


@pytest.mark.parametrize(("size", "kept"), [(11.0, ["friction_coulomb"]), (5.0, [])])
def test_friction_that_the_steady_speeds_show_is_kept_beside_a_ringing(size: float, kept: list[str]) -> None:
    judged = problem(0.0)
    found = fit(judged, (claim(DRY, size),), iterations=0)
    assert [one.effect.label for one in seen_at_steady_speed(judged, (), found)] == kept
    assert not seen_at_steady_speed(judged, found.claims, found)


def test_a_size_that_depends_on_names_that_are_not_claimed_is_refused() -> None:
    judged = problem(0.0)
    found, other = (fit(judged, (claim(DRY, size),), iterations=0) for size in (11.0, 7.0))
    for earlier, refused in (([found], []), ([found, other], ["friction_coulomb"])):
        assert [*contradicted(judged, found, earlier, [Interval(11.0, 10.0, 12.0, True)], (), 0.1, 20.0)] == refused


def test_evidence_counts_samples_that_are_independent() -> None:
    judged = problem(0.0)
    found = fit(judged, (claim(DRY, 11.0),))
    for inflation, refused in ((1.0, []), (1e3, ["friction_coulomb"])):
        bounds = [Interval(11.0, 10.0, 12.0, True, inflation)]
        assert [*contradicted(judged, found, [], bounds, (), 0.1, 20.0)] == refused


def test_a_constant_is_no_name_where_the_force_does_not_follow_the_motion() -> None:
    table = strokes(0.0, "run")
    table.columns["hydraulic_force"] = 100.0 + np.random.default_rng(2).standard_normal(len(table.time))
    judged = Problem([checked(table, BENCH).segments[0]], BENCH)
    found = fit(judged, (claim("force_offset", -100.0),))
    reasons = contradicted(judged, found, [], [Interval(-100.0, -101.0, -99.0, True)], (), 0.1, 20.0)
    assert "no better than the force's mean" in reasons["force_offset"]


def test_claims_on_which_the_recordings_do_not_agree_are_told() -> None:
    for forces, told in (((4.0, 4.0), []), ((4.0, 0.0), ["force_offset"])):
        judged = problem(*forces)
        found = fit(judged, (claim(DRY, 10.0), claim("force_offset", 2.0)))
        bounds = [Interval(one, one - 0.1, one + 0.1, True) for each in found.claims for one in each.values.values()]
        assert moved(judged, found, bounds) == told


def test_what_is_left_and_what_is_not_identified_are_objections() -> None:
    found = fit(problem(0.0), (claim(DRY, 11.0),), iterations=0)
    sure, vague = (Interval(11.0, 10.0, 12.0, identified) for identified in (True, False))
    assert objections(found, [sure], proof(10.0, 2.0), ()) == []
    assert "43 %" in objections(found, [sure], proof(10.0, 4.3), ())[0]
    assert objections(found, [sure], proof(1.3, 1.1), ()) == []
    assert "friction_coulomb: force" in objections(found, [vague], proof(10.0, 1.0), ())[0]
    assert explained_shares(proof(10.0, 1.0)) == {"motion": 1.0} and explained_shares(proof(1.1, 1.0)) == {}


@pytest.mark.parametrize("noise, level, cut", [(2e5, 5e5, False), (2e5, 0.0, True), (1e3, 2e4, True)])
def test_cavitation_is_what_noise_does_not_make(noise: float, level: float, cut: bool, nominal: Any) -> None:
    """A return line at 5 bar whose sensor has 2 bar of noise does not cavitate."""
    columns = {name: frame(nominal)[name].to_numpy().copy() for name in ("piston_position", "pressure_a")}
    columns["pressure_a"][:] = 5e5
    columns["pressure_a"][4000:5000] = level
    columns["pressure_a"] += noise * np.random.default_rng(1).standard_normal(len(columns["pressure_a"]))
    table = RawTable("run", 1e-3 * np.arange(len(columns["pressure_a"]), dtype=np.float64), None, columns)
    assert any("cavitate" in note for note in checked(table, Bench.nominal()).quality) == cut


@pytest.mark.parametrize("given_back, refused", [(1.0, []), (0.0, ["moving_mass"])])
def test_what_only_resists_speeding_up_is_no_mass(given_back: float, refused: list[str]) -> None:
    time, random = 1e-3 * np.arange(10_000.0), np.random.default_rng(2)
    phase = 2.0 * np.pi * 0.7 * time
    position, speed, rate = 0.03 + 0.02 * np.sin(phase), np.cos(phase), -np.sin(phase) * 0.02 * (2.0 * np.pi * 0.7) ** 2
    beyond = 20.0 * rate * np.where(rate * speed > 0.0, 1.0, given_back)
    force = rate + beyond + 0.3 * random.standard_normal(len(time))
    table = RawTable("sine", time, None, {"piston_position": position, "hydraulic_force": force})
    judged = Problem([checked(table, BENCH).segments[0]], BENCH)
    found = fit(judged, (claim("moving_mass", 10.0),))
    assert differing(judged, found, intervals(judged, found)) == refused


NOMINAL = Bench.nominal()
RISE = claim("friction_stribeck", 8.0, 0.012)
"""Stribeck friction without any other: the piston stops and breaks loose by tenths of a newton."""


def test_windows_that_nothing_can_predict_are_left_out_and_a_wrong_model_gains_nothing_by_it() -> None:
    truth = replace(NOMINAL, effects=(RISE.to_mapping(),))
    states = record(truth, 11, seconds=25.0, waveform=Waveform.SMOOTH_STEP)
    held = [SegmentModel(segment(states), NOMINAL)]

    def against_nothing(*claims: Claim) -> tuple[Comparison, float, float]:
        found = compare(held, (), claims, sensor_noise(held), seconds=HORIZON, windows=48, shooting=True)
        worst = (max(one[key] / one["noise_floor"] for one in found.channels.values())
                 for key in ("rmse_after", "rmse_after_all"))  # fmt: skip
        return found, *worst

    found, kept, every = against_nothing(RISE)
    assert found.left_out and len(found.left_out) <= MOST * found.windows
    assert kept < 1.15 < 3.0 < every
    assert all(window["recording"] == "run" and 0.0 < window["start"] < 25.0 for window in found.left_out)
    for claims in ((), (claim("friction_stribeck", 2.0, 0.012),)):  # no friction, too little
        _, kept, every = against_nothing(*claims)
        assert kept > 0.8 * every > 5.0


SLOW, FAST = 60.0, 300.0
"""Amplitudes of the reference [N]."""


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
    bench = replace(NOMINAL, **truth)
    fitted, unseen = (problem_in(record(bench, seed, amplitude=size)) for seed, size in ((1, SLOW), (2, FAST)))
    found = fit(fitted, [*map(claim, named)])
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
    dragged = replace(NOMINAL, effects=({"id": "friction_viscous", "parameters": {"coefficient": 300.0}},))
    for name, bench, seed in (("with", dragged, 1), ("without", NOMINAL, 2), ("again", dragged, 3)):
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
