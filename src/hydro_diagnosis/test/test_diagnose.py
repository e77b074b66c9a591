# SPDX-License-Identifier: Apache-2.0
"""A diagnosis from files to report, page and corrected bench; also from the model of a bench that wears."""

from __future__ import annotations

import json
import re
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd
import pytest
import yaml
from scipy.ndimage import uniform_filter1d

import hydro_diagnosis
from hydro_bridge.bags.recording import BagWriter
from hydro_core.signals import StateArray
from hydro_diagnosis import diagnose
from hydro_diagnosis.cli import run
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.estimation.fit import fit
from hydro_diagnosis.estimation.problem import Problem
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_diagnosis.recording import InputError
from hydro_diagnosis.report.corrected_bench import claims_of, corrected_bench
from hydro_diagnosis.report.diagnosis import interval
from hydro_diagnosis.stages.parameter_checks import confirmation_note
from hydro_diagnosis.stages.reading import baseline
from hydro_diagnosis.validation import equation_errors
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.files.learned_bench import shipped_bench
from hydro_sim.model.bench import Bench
from tests.checks import ran
from tests.segments import claim, frame, problem_in, record

NOMINAL = Bench.nominal()


def fast_cylinder(seconds: float, friction: float, stroke: float) -> pd.DataFrame:
    """From stop to stop in 0.6 to 1.4 s, 0.1 to 0.4 s of rest there, pressures against the atmosphere."""
    random, place, outwards = np.random.default_rng(3), [np.zeros(200)], True
    while sum(map(len, place)) < 1e3 * seconds:
        length = int(random.uniform(600, 1400))
        shape = np.minimum(1.0, np.minimum(np.arange(length), np.arange(length)[::-1]) / 60.0)
        covered = stroke * np.cumsum(shape) / np.sum(shape)
        ends = covered if outwards else stroke - covered
        place += [ends, np.full(int(random.uniform(100, 400)), ends[-1])]
        outwards = not outwards
    position = np.concatenate(place)[: int(1e3 * seconds)]
    speed = 1e3 * np.gradient(position)
    force = friction * np.tanh(speed / 2e-3) + 3.0 * 1e3 * np.gradient(uniform_filter1d(speed, 15))
    pressures = np.stack([np.where(speed >= 0.0, force / 3.1e-4, 0.0), np.where(speed >= 0.0, 0.0, -force / 2.6e-4)])
    pressures = np.maximum(pressures, 0.0) + random.normal(0.0, 3e3, pressures.shape)
    return pd.DataFrame({"time": 1e-3 * np.arange(len(position)), "pressure_a": pressures[0],
                         "pressure_b": pressures[1],
                         "piston_position": position + random.normal(0.0, 3e-6, len(position))})  # fmt: skip


def test_strokes_of_a_second_from_stop_to_stop_are_used_and_no_area_is_blamed(tmp_path: Path) -> None:
    """A constant force at any speed is dry friction; a smaller area would make it, and the noise, smaller."""
    fast_cylinder(40.0, 68.0, 0.1).to_csv(tmp_path / "run.csv", index=False)
    known = {"piston_area": 3.1e-4, "area_ratio": 2.6 / 3.1, "stroke": 0.1, "moving_mass": 3.0}
    (tmp_path / "bench.yaml").write_text(yaml.safe_dump(known))
    report = diagnose([tmp_path / "run.csv"], bench=tmp_path / "bench.yaml").report
    (friction,) = report.effects
    assert friction.id == "friction_coulomb" and friction.parameters["force"].value == pytest.approx(68.0, rel=0.02)


def test_command_writes_a_report_a_page_and_a_bench_with_which_nothing_is_found(
    worn: list[Path], tmp_path: Path, valid: Callable[[Any], Any]
) -> None:
    assert run([str(worn[0]), str(worn[1]), "--holdout", str(worn[2]), "--out", str(tmp_path), "--quiet"]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    valid(report)
    assert report["steps"] and report["verdict"] == "explained"
    assert report["checked"] == ["pressure_a", "pressure_b", "actuation", "motion", "load", "sensor"]
    (spring,) = report["effects"]
    low, high = spring["parameters"]["ratio"]["ci95"]
    assert spring["id"] == "spring_stiffness" and low <= 18500.0 / 20000.0 <= high
    assert report["location"][0]["equation"] == "load"
    assert spring["evidence"]["holdout_gain"] == pytest.approx(1.0, abs=0.05)
    for channel, error in report["fit"]["holdout"].items():
        assert error["rmse_after"] < 1.1 * error["noise_floor"], channel
    assert report["fit"]["holdout"]["load_force"]["rmse_before"] > 5.0
    page = (tmp_path / "report.html").read_text()
    elsewhere = r"""(?:src|href)=["'](?!#|data:)[^"']*""", r"@import|url\((?!#)"
    assert not any(re.findall(one, page) for one in elsewhere)
    corrected = Bench.load(tmp_path / "corrected.yaml")
    assert corrected.spring_stiffness == pytest.approx(18500.0, rel=2e-3)
    assert diagnose([worn[2]], bench=corrected).report.verdict == "no_mismatch"


def test_recordings_of_one_name_are_told_apart_by_their_paths(worn: list[Path], tmp_path: Path) -> None:
    """Seen: a crash, or the last third of one said to be held out where another was; one forecast for all."""
    same = [tmp_path / str(k) / "run.csv" for k in range(3)]
    for path, copy in zip(worn, same, strict=True):
        copy.parent.mkdir()
        shutil.copyfile(path, copy)
    found = diagnose(same[:1], holdout=same[1:])
    assert found.used.startswith(f"fitted on {same[0]} (") and "last third" not in found.used
    assert [one.recording for one in found.report.forecast] == [*map(str, same[1:])]


def test_numbers_of_the_bench_file_are_confirmed_if_they_are_right(problem: Problem) -> None:
    area = 1.1 * problem.bench.piston_area
    wrong = Problem([problem.models[0].segment], replace(problem.bench, piston_area=area))
    told = [confirmation_note(one, fit(one, []), [], LIBRARY) for one in (problem, wrong)]
    assert "piston area within 0.3 %" in told[0] and "piston area" not in told[1]


def test_wrong_modulus_and_valve_gain_become_numbers_of_the_bench(problem: Problem) -> None:
    claims = [claim("bulk_modulus", 0.9), claim("valve_gain", 1.05)]
    corrected, model = corrected_bench(problem.bench, claims), problem.models[0]
    assert corrected.effects == ()
    assert corrected.valve_gain == pytest.approx(1.05 * problem.bench.valve_gain)
    as_effects, as_numbers = model.chamber_run(claims), SegmentModel(model.segment, corrected).chamber_run(())
    np.testing.assert_allclose(as_numbers.innovations, as_effects.innovations, rtol=1e-9, atol=1e-3)


def test_order_that_matters_keeps_the_modulus_an_effect() -> None:
    claims = [claim("entrained_air", 0.01), claim("bulk_modulus", 0.9)]
    corrected, turned = corrected_bench(NOMINAL, claims), corrected_bench(NOMINAL, claims[::-1])
    assert [effect["id"] for effect in corrected.effects] == ["entrained_air", "bulk_modulus"]
    assert corrected.bulk_modulus == NOMINAL.bulk_modulus
    assert [effect["id"] for effect in turned.effects] == ["entrained_air"]
    assert turned.bulk_modulus == pytest.approx(0.9 * NOMINAL.bulk_modulus)


def test_equation_errors_do_not_contradict_the_verdict() -> None:
    """Near reversals dry friction may have either sign: counted in full, they would leave ten times the noise."""
    dry = corrected_bench(NOMINAL, [claim("friction_coulomb", 15.0)])
    fitted, held = (problem_in(record(dry, seed, seconds=8.0)) for seed in (40, 41))
    claims = fit(fitted, [claim("friction_coulomb", 10.0)]).claims
    motion = equation_errors(held.reweighted(claims), claims)["motion"]
    assert motion["rmse_before"] > 30.0 * motion["noise_floor"]
    assert motion["rmse_after"] < 1.2 * motion["noise_floor"]


def test_cause_that_there_is_none_of_is_refused_before_anything_is_read(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="'bcklash' is not an effect, did you mean 'backlash'"):
        diagnose([tmp_path / "nowhere"], without=["bcklash"])


def test_bad_input_ends_in_one_sentence_and_status_2(tmp_path: Path) -> None:
    words = ("-m", "hydro_diagnosis.cli", tmp_path / "none.mcap", "--out", tmp_path / "out", "--quiet")
    ended = ran(sys.executable, *words)
    (sentence,) = ended.stderr.strip().splitlines()
    assert ended.returncode == 2 and "there is no such recording" in sentence
    assert not (tmp_path / "out").exists(), "nothing is left behind"


INTERRUPTED_RUN = """
import os, signal
from hydro_diagnosis import cli
from hydro_diagnosis.selection import search
swap = search.Search._swap
def interrupted(self, *words):
    os.kill(os.getpid(), signal.SIGINT)
    return swap(self, *words)
search.Search._swap = interrupted
cli.main()
"""


def test_interrupt_leaves_nothing_behind(worn: list[Path], tmp_path: Path) -> None:
    """Ctrl-C when the search has begun; a terminal sends it to the whole process group, here to the one process."""
    ended = ran(sys.executable, "-c", INTERRUPTED_RUN, *worn[:2], "--out", tmp_path / "out", timeout=60)
    assert ended.returncode == 130, ended.stderr
    assert "Traceback" not in ended.stderr and not (tmp_path / "out").exists()


def test_no_mismatch(valid: Callable[[Any], Any], nominal: StateArray, tmp_path: Path) -> None:
    frame(nominal).to_csv(tmp_path / "nominal.csv", index=False)
    found = diagnose([tmp_path / "nominal.csv"])
    assert "fitted on two thirds of " in str(found) and len(repr(found)) < 2000
    report = json.loads(found.report.to_json())
    valid(report)
    assert report["verdict"] == "no_mismatch"
    assert report["recordings"] == [{"name": "nominal", "begin": None}]
    (forecast,) = report["forecast"]
    assert forecast["rmse_corrected"] == forecast["rmse_bench_file"] and not forecast["misses"]
    assert report["simulated"] is None


def test_something_left_that_nobody_knows(valid: Callable[[Any], Any], tmp_path: Path) -> None:
    """A cell that is struck twice a second, and no current, no pressures: nothing can be simulated forward."""
    states = record(NOMINAL, 7)
    table = frame(states)[["time", "hydraulic_force", "load_force", "piston_position"]]
    table.loc[(states["time"] % 0.5) < 0.02, "load_force"] += 40.0
    table.to_csv(tmp_path / "struck.csv", index=False)
    report = json.loads(diagnose([tmp_path / "struck.csv"]).report.to_json())
    valid(report)
    assert report["verdict"] == "unknown" and report["effects"] == []
    assert report["checked"] == ["motion", "load"] and report["forecast"] is None
    forecast = "forecast: struck: no force law or reference"
    assert "pressure_a" in report["not_checked"]
    assert any(one.startswith(forecast) for one in report["not_checked"])
    assert report["remainder"]["location"] and report["fit"]["why"]


def test_interval_is_written_with_the_digits_that_tell_its_ends_apart() -> None:
    low, high = interval([537678.6, 537684.9]).removeprefix("95 % ").split(" to ")
    assert float(low) < float(high)
    assert interval([1.0, 2.0]) == "95 % 1 to 2"


def test_ids_of_the_contract_are_those_of_the_library() -> None:
    schema = Path(hydro_diagnosis.__file__).parent / "data" / "report.schema.json"
    table = json.loads(schema.read_text())["definitions"]["cause"]["enum"]
    assert set(table) == {effect.id for effect in LIBRARY}


HEALTHY_FRICTION, HEALTHY_LEAK = 12.0, 1e-13


def test_learned_constants_become_the_bench_and_its_effects() -> None:
    believed, origin = baseline(None, shipped_bench())
    assert origin == "learned learned_bench.yaml"
    assert believed.moving_mass == pytest.approx(1.2, rel=5e-3)
    assert believed.load_cell_bandwidth is None
    assert believed.valve_gain == pytest.approx(NOMINAL.valve_gain, rel=1e-3)
    claims = {claim.effect.id: dict(claim.values) for claim in claims_of(believed)}
    assert claims["valve_lag"]["bandwidth"] == pytest.approx(110.0, rel=1e-2)
    assert claims["friction_coulomb"]["force"] == pytest.approx(HEALTHY_FRICTION, rel=1e-2)
    assert claims["sensor_lag"] == pytest.approx({"bandwidth": 25.0, "damping": 0.55}, rel=5e-3)


@pytest.mark.study
@pytest.mark.xfail(strict=True, reason="0.015 % of air is named: the shipped learned bench leaves 1.02 times the noise")
def test_leak_and_friction_are_named_as_changes_and_corrected_as_wholes(tmp_path: Path) -> None:
    """Three runs of the emulator's default truth with wear; corrected.yaml is a baseline by itself: of the worn bench.

    The diagnosis knows no truth plant.
    """
    wear = {"leakage_internal": {"coefficient": 1e-12}, "friction_coulomb": {"force": 18.0, "form": "lugre"}}
    truth = truth_from_mapping({"profile": "default", "effects": wear})
    bags = [tmp_path / f"run{k}" for k in range(3)]
    for k, (waveform, frequency) in enumerate((("multisine", 0.7), ("smooth_step", 0.8), ("sine", 1.1))):
        drive = Segment(seconds=15, waveform=waveform, amplitude=250, frequency=frequency, kp=60, ki=10)
        with BagWriter(bags[k]) as writer:
            writer.write_states(record_offline(truth, [drive], seed=50 + k).states)
    assert run([*map(str, bags), "--model", str(shipped_bench()), "--out", str(tmp_path), "--quiet"]) == 0
    report = json.loads((tmp_path / "report.json").read_text())
    named = {effect["id"]: next(iter(effect["parameters"].values()))["value"] for effect in report["effects"]}
    assert named == {
        "leakage_internal": pytest.approx(1e-12 - HEALTHY_LEAK, rel=0.02, abs=0.0),
        "friction_coulomb": pytest.approx(18.0 - HEALTHY_FRICTION, rel=0.02),
    }
    corrected = Bench.load(tmp_path / "corrected.yaml")
    for effect, parameter, size in ("leakage_internal", "coefficient", 1e-12), ("friction_coulomb", "force", 18.0):
        whole = sum(float(one["parameters"][parameter]) for one in corrected.effects if one["id"] == effect)
        assert whole == pytest.approx(size, rel=0.01, abs=0.0)
    assert diagnose([bags[2]], bench=corrected).report.verdict == "no_mismatch"
