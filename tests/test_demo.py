# SPDX-License-Identifier: Apache-2.0
"""The demonstration's parts, without its trainings: `make demo` runs the whole."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import pytest

from demo import stages, trial
from hydro_policy.evaluation.controllers import FixedGains
from hydro_policy.evaluation.session import EvaluationSettings
from hydro_sim.model.bench import Bench

TRUTH = Path(trial.__file__).parent / "truth.yaml"
BELIEVED = replace(Bench.nominal(), load_cell_bandwidth=None)
KNOWN = Bench.nominal()
"""With the amplifier that the demonstration's bench has."""


@pytest.fixture(autouse=True)
def one_sine(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = EvaluationSettings(frequencies=(1.0,), settle=1.0, measure=1.0)
    monkeypatch.setattr(trial, "SETTINGS", settings)


@pytest.mark.study
def test_what_the_simulation_likes_best_trips_the_bench_that_it_does_not_know() -> None:
    blind, knowing = trial.best_fixed(BELIEVED, BELIEVED), trial.best_fixed(KNOWN, BELIEVED)
    assert blind == max(trial.GRID)
    assert knowing < blind
    before, after = FixedGains(blind, trial.INTEGRAL), FixedGains(knowing, trial.INTEGRAL)
    assert trial.in_simulation(before, BELIEVED, BELIEVED).trips == 0
    assert trial.on_bench(before, TRUTH, BELIEVED).trips == 1
    met = trial.on_bench(after, TRUTH, BELIEVED)
    assert met.trips == 0
    assert met.trace["time"][-1] == pytest.approx(2.0, abs=0.01)
    assert met.mean == pytest.approx(trial.in_simulation(after, KNOWN, BELIEVED).mean, rel=0.1)


def test_stages_that_are_done_are_not_done_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    plan = stages.Plan(folder=tmp_path, truth=TRUTH, seeds=2)
    asked: list[list[str]] = []
    monkeypatch.setattr(stages, "_run", lambda words: asked.append(list(words)))
    stages.believe(plan)
    assert Bench.load(plan.believed).load_cell_bandwidth is None
    done, begun = plan.policies("pretrained")
    done.mkdir()
    (done / "curve.json").touch()
    begun.mkdir()
    (begun / "config.yaml").touch()
    stages.pretrain(plan, "pretrained", plan.believed)
    assert [words[2:4] for words in asked] == [["--resume", str(begun)]]
