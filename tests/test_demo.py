# SPDX-License-Identifier: Apache-2.0
"""The demonstration's parts, without its trainings: `make demo` runs the whole."""

from __future__ import annotations

from pathlib import Path

import pytest

from demo import stages, trial
from hydro_policy.evaluation.session import EvaluationSettings
from hydro_sim.model.bench import Bench

TRUTH = Path(trial.__file__).parent / "truth.yaml"


@pytest.fixture(autouse=True)
def one_sine(monkeypatch: pytest.MonkeyPatch) -> None:
    settings = EvaluationSettings(frequencies=(1.0,), settle=1.0, measure=1.0)
    monkeypatch.setattr(trial, "SETTINGS", settings)


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
