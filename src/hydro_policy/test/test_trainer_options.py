# SPDX-License-Identifier: Apache-2.0
"""What the trainer refuses by its words alone, and what stays of a run that never began."""

from __future__ import annotations

from pathlib import Path

import pytest

pytest.importorskip("rclpy")

from hydro_policy.nodes.trainer import asked
from hydro_policy.pretraining.configurations import configuration
from hydro_policy.runs.run import RunDirectory


@pytest.fixture
def run(tmp_path: Path) -> RunDirectory:
    directory = RunDirectory(tmp_path / "a").create()
    directory.save_settings(configuration("wide", seed=3))
    return directory


def test_a_run_that_goes_on_takes_what_may_change_and_the_same_words_again(run: RunDirectory) -> None:
    resume = ["--plant", "emulator", "--resume", str(run.path)]
    assert asked([*resume, "--episodes", "320", "--exam-every", "8", "--updates-per-step", "2"]).episodes == 320
    place = ["--runs", str(run.path.parent), "--name", "a"]
    assert asked([*resume, "--configuration", "wide", "--seed", "3", *place]).resume == run.path
    assert asked(["--demo", "--resume", str(run.path)]).evaluate, "the main job's defaults are nobody's words"
