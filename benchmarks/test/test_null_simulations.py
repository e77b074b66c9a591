# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
from dataclasses import replace
from math import exp, inf
from pathlib import Path

import pytest

from benchmarks.null_simulations import Trial, calibrated, load, needed, run, save, trial
from hydro_bridge.cli.console import UserError
from hydro_sim.model.bench import Bench

BENCH = Bench.nominal()
TRIALS = {3: Trial(0.5, -inf, "none"), 7: Trial(2.0, 8.25, "valve_gain"), 8: Trial(0.1, -15.5, "backlash")}


def test_trials_are_kept_whole(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    assert load(path, BENCH) == {}
    save(path, BENCH, TRIALS, 20.0)
    assert load(path, BENCH) == TRIALS
    assert json.loads(path.read_text())["outcome"]["false"] == 0


def test_trials_of_another_bench_do_not_add_up(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    save(path, BENCH, TRIALS, 20.0)
    with pytest.raises(UserError, match="another bench"):
        load(path, replace(BENCH, moving_mass=2.0))


def test_trials_of_another_version_do_not_add_up(tmp_path: Path) -> None:
    path = tmp_path / "calibration.json"
    save(path, BENCH, TRIALS, 20.0)
    path.write_text(path.read_text().replace('"engine": "', '"engine": "x'))
    with pytest.raises(UserError, match="another version"):
        load(path, BENCH)


@pytest.mark.parametrize("content", ["{}", "[1]", "no JSON", '{"bench": 1, "engine": 2}'])
def test_another_file_is_not_taken_for_trials(tmp_path: Path, content: str) -> None:
    path = tmp_path / "other.json"
    path.write_text(content)
    with pytest.raises(UserError, match=r"no null simulations|another bench"):
        load(path, BENCH)
    assert path.read_text() == content


@pytest.mark.parametrize("words", [["--runs", "0"], ["--jobs", "0"]])
def test_no_runs_and_no_processes_are_refused(words: list[str]) -> None:
    with pytest.raises(UserError, match="at least"):
        run(words)


def test_finished_trials_are_not_searched_again(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "calibration.json"
    save(path, BENCH, {0: Trial(1.0, 8.25, "valve_gain"), 1: Trial(1.0, -inf, "none")}, 20.0)
    assert run(["--runs", "2", "--jobs", "1", "--write", str(path)]) == 0
    assert "2 pairs of recordings: the threshold in use, 20, was passed 0 times" in capsys.readouterr().out


def test_threshold_is_worth_what_the_trials_reach() -> None:
    trials = [Trial(1.0, evidence, "x") for evidence in (1.0, 2.0, 3.0, 4.0, 5.0, 30.0)]
    outcome = calibrated(trials, 20.0)
    assert outcome.false == 1
    assert outcome.limit == pytest.approx(0.582, abs=1e-3)  # Clopper and Pearson, 1 of 6
    middle, excess = 3.5, (0.5 + 1.5 + 26.5) / 3
    assert outcome.expected == pytest.approx(0.5 * exp(-(20.0 - middle) / excess))
    assert needed(trials, 1e-3) >= 30.0


def test_mass_that_a_coarse_encoder_hides_is_not_claimed() -> None:
    slow = trial(BENCH, 28)  # 0.4 and 0.9 Hz, an encoder of 2.3 um: by least squares 0.19 kg are missing, BIC 47
    assert slow.noise == pytest.approx(2.32, abs=0.01)
    assert slow.claim != "moving_mass"
    assert slow.evidence < 20.0
