# SPDX-License-Identifier: Apache-2.0
"""The judge: shares on what was held out, the verdict they give, and names that must predict."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from hydro_core.signals import Waveform
from hydro_diagnosis.bench_numbers import parse_bench
from hydro_diagnosis.cli import run
from hydro_diagnosis.effects import Claim
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import Problem, sensor_noise
from hydro_diagnosis.io.table import RawTable
from hydro_diagnosis.judge import accounted_shares, assess, retain_claims
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.validation import HORIZON, MOST, Comparison, compare, equation_errors
from hydro_sim.model.bench import Bench
from tests.segments import claim, frame, record, segment

DRY = "friction_coulomb"
BENCH = parse_bench({"moving_mass": 1.0}, frozenset())
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
    return Problem([check_recording(table, BENCH).segments[0] for table in tables], BENCH)


def errors(after: float, before: float = 10.0) -> dict[str, dict[str, float]]:
    return {"motion": {"rmse_before": before, "rmse_after": after, "noise_floor": 1.0}}


def test_shares_are_of_root_mean_squares_with_the_noise_taken_off() -> None:
    left = np.sqrt(1.0 + 0.04 * 99.0)
    assert accounted_shares(errors(1.0), errors(left))["motion"] == pytest.approx({"named": 0.8, "all": 1.0})
    assert accounted_shares(errors(1.0, 1.1), errors(1.0, 1.1)) == {}  # the bench file misses nothing but noise


@pytest.mark.parametrize(("size", "verdict"), [(11.0, "explained"), (9.0, "partly_explained")])
def test_everything_is_explained_only_where_what_was_held_out_is(size: float, verdict: str) -> None:
    """20 N s/m are left beside dry friction alone: little of the force, but more than noise."""
    claims = (claim(DRY, 10.0), claim("friction_viscous", 20.0)) if size == 11.0 else (claim(DRY, size),)
    fitted, held = problem(0.0).reweighted(claims), problem(0.0).reweighted(claims)
    found = fit(fitted, claims, iterations=0)
    nothing = fit(fitted, ())
    proof = equation_errors(held, found.claims)
    assert assess(fitted, found, found, nothing, held, accounted_shares(proof, proof)).verdict == verdict


def test_a_name_that_makes_what_was_held_out_worse_is_not_claimed() -> None:
    claims = (claim(DRY, 10.0), claim("friction_viscous", 20.0), claim("force_offset", -4.0))
    fitted = problem(4.0).reweighted(claims)
    found, nothing = fit(fitted, claims), fit(fitted, ())
    for held, claimed in ((problem(4.0), True), (problem(0.0), False)):
        kept, _ = retain_claims(fitted, held, found, nothing)
        assert ("force_offset" in {one.effect.label for one in kept.claims}) == claimed


@pytest.mark.parametrize(
    "noise, level, tank, cut",
    [
        (2e5, 5e5, 1e5, False),
        (2e5, 0.0, 1e5, True),
        (1e3, 2e4, 1e5, True),
        (1e3, 2e4, 0.0, False),
        (1e3, -8e4, 0.0, True),
    ],
)
def test_cavitation_is_what_noise_does_not_make(
    noise: float, level: float, tank: float, cut: bool, nominal: Any
) -> None:
    """A return line at 5 bar whose sensor has 2 bar of noise does not cavitate, nor does a gauge at its zero."""
    columns = {
        name: frame(nominal)[name].to_numpy().copy() for name in ("piston_position", "pressure_a", "valve_current")
    }
    columns["pressure_a"][:] = 5e5
    columns["pressure_a"][4000:5000] = level
    columns["pressure_a"] += noise * np.random.default_rng(1).standard_normal(len(columns["pressure_a"]))
    table = RawTable("run", 1e-3 * np.arange(len(columns["pressure_a"]), dtype=np.float64), None, columns)
    bench = replace(Bench.nominal(), tank_pressure=tank)
    assert any("cavitate" in note for note in check_recording(table, bench).quality) == cut
    del columns["valve_current"]  # no equation of the oil is checked
    assert not any("cavitate" in note for note in check_recording(table, bench).quality)


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


@pytest.mark.study
def test_names_that_predict_the_held_out_recordings_worse_than_the_bench_file_are_not_claimed(
    tmp_path: Path,
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
        errors = report["fit"]["holdout"].values()
        assert all(error["rmse_after"] <= 1.1 * error["rmse_before"] + error["noise_floor"] for error in errors)
