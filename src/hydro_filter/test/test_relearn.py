# SPDX-License-Identifier: Apache-2.0
"""Model and metric anew by one command: whose folder it is, what is gone on with, and a changed bench that it fits."""

from __future__ import annotations

import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from hydro_filter.controller.factory import FilterChoice
from hydro_filter.training.relearn import METRIC, MODEL
from hydro_sim.files.learned_bench import load_model
from hydro_sim.model.bench import Bench


def relearn(*words: str | Path) -> subprocess.CompletedProcess[str]:
    code = "from hydro_filter.training.relearn import main; main()"
    command = [sys.executable, "-c", code, *map(str, words)]
    return subprocess.run(command, capture_output=True, text=True, timeout=900.0, check=False)


def test_a_folder_of_something_else_is_refused(tmp_path: Path) -> None:
    (tmp_path / "mine.txt").write_text("mine")
    done = relearn("bag", "--out", tmp_path)
    assert done.returncode == 2
    assert "is not empty: name another folder, or go on in it with --resume" in done.stderr
    assert "holds nothing to go on with" in relearn("bag", "--out", tmp_path, "--resume").stderr
    assert [path.name for path in tmp_path.iterdir()] == ["mine.txt"]


def test_what_fails_says_so_and_is_gone_on_with_on_the_same_recordings_only(tmp_path: Path) -> None:
    out = tmp_path / "out"
    done = relearn(tmp_path / "nothing", "--out", out)
    assert done.returncode == 2
    assert "learn ended with status 2: mend what it says, then go on by --resume" in done.stderr.splitlines()[-1]
    assert "nothing" in done.stderr.splitlines()[-2]
    other = relearn(tmp_path / "other", "--out", out, "--resume")
    assert other.returncode == 2
    assert f"was begun with {tmp_path / 'nothing'}" in other.stderr


@pytest.mark.study
@pytest.mark.exhaustive
def test_a_minute_of_a_changed_bench_gives_a_filter_for_it(tmp_path: Path) -> None:
    truth, bag, out = tmp_path / "truth.yaml", tmp_path / "bag", tmp_path / "out"
    truth.write_text(yaml.safe_dump({"profile": "default", "bench": {"spring_stiffness": 3e4}}))
    code = "from hydro_sim.emulator.command import main; main()"
    words = ["--offline", "--truth", str(truth), "--seconds", "60", "--out", str(bag)]
    subprocess.run([sys.executable, "-c", code, *words], check=True, capture_output=True)
    done = relearn(bag, "--out", out)
    assert done.returncode == 0, done.stderr
    effects = {effect["id"]: effect["parameters"] for effect in load_model(out / MODEL).effects}
    assert effects["spring_stiffness"]["ratio"] == pytest.approx(1.5, rel=0.01)
    assert not FilterChoice(bench=Bench.nominal(), metric=str(out / METRIC), model=out / MODEL).trouble()
