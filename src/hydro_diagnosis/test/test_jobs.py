# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from hydro_core.errors import UserError
from hydro_diagnosis import jobs
from tests.checks import files_of_at_most


def marked(number: int, folder: Path) -> tuple[int, float, int]:
    """A number of this seed alone, and who drew it; leaves a file for each time that it is done.

    Number 2 is killed the first time, 3 each time, 4 is no number.
    """
    done = len([*folder.glob(f"{number}-*")])
    (folder / f"{number}-{done}").touch()
    if number == 3 or (number == 2 and not done):
        os.kill(os.getpid(), signal.SIGKILL)
    if number == 4:
        raise UserError("it holds no numbers")
    return number, random.Random(number).random(), os.getpid()


@pytest.fixture
def cluster(tmp_path: Path) -> Iterator[str]:
    """A scheduler and two workers, as started by hand."""
    file = tmp_path / "scheduler.json"
    dask, to = [sys.executable, "-m", "dask"], ["--no-dashboard", "--scheduler-file", str(file)]
    scheduler = [*dask, "scheduler", "--host", "127.0.0.1", "--port", "0", *to]
    workers = [*dask, "worker", "--nworkers", "2", "--nthreads", "1", *to]
    started = [
        subprocess.Popen(each, stderr=subprocess.DEVNULL, start_new_session=True) for each in (scheduler, workers)
    ]
    try:
        while not file.exists() or not file.read_text().rstrip().endswith("}"):
            time.sleep(0.1)
        yield json.loads(file.read_text())["address"]
    finally:
        for process in started:  # workers without a scheduler do not end for a while
            os.killpg(process.pid, signal.SIGKILL)
            process.wait()


def test_poisoned_job_is_named_and_the_rest_is_done(capsys: pytest.CaptureFixture[str]) -> None:
    found = {}
    with pytest.raises(UserError, match=r"^1 of 3 jobs failed: b; the others are done$"):
        for name, result in jobs.run(divmod, {"a": (1, 1), "b": (1, 0), "c": (4, 2)}, processes=1):
            found[name] = result
    assert found == {"a": (1, 0), "c": (2, 0)}
    said = capsys.readouterr().err
    assert "b: Traceback" in said and "ZeroDivisionError" in said


@pytest.mark.slow
def test_job_whose_process_is_killed_is_done_again_poison_kills_no_other_and_results_are_those_of_one_process(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    wanted = {f"recording {number}": (number, tmp_path) for number in range(8)}
    found = {}
    with pytest.raises(UserError, match=r"2 of 8 jobs failed: recording 3, recording 4; the others"):
        for name, result in jobs.run(marked, wanted, processes=2, results_file=tmp_path / "results"):
            found[name] = tuple(result)
    done = [len([*tmp_path.glob(f"{number}-*")]) for number in range(8)]
    assert done[2] >= 2 and done[3] == jobs.WORKER_DEATHS_MAX
    assert max(done) <= jobs.WORKER_DEATHS_MAX and min(done) >= 1, (
        "a result may die with the process that takes the next job"
    )
    said = capsys.readouterr().err
    assert "recording 4: it holds no numbers" in said
    assert "recording 3: it killed each process that did it" in said
    sound = {name: values for name, values in wanted.items() if values[0] not in (3, 4)}
    alone = jobs.run_all(marked, sound, processes=1)
    assert {name: result[:2] for name, result in found.items()} == {name: result[:2] for name, result in alone.items()}
    assert {process for *_, process in alone.values()} == {os.getpid()}
    assert len({process for *_, process in found.values()} - {os.getpid()}) >= 2
    again = jobs.run_all(marked, sound, results_file=tmp_path / "results", processes=1)
    assert list(again) == list(sound) and all(tuple(again[name]) == found[name] for name in sound), "in this order"


@pytest.mark.slow
def test_cluster_gives_what_this_process_gives_though_a_worker_is_killed(cluster: str) -> None:
    who: set[int] = set()
    while len(who) < 2:  # the second worker takes longer to start
        who |= {*jobs.run_all(os.getpid, {str(number): () for number in range(4)}, scheduler=cluster).values()}
    assert os.getpid() not in who
    assert jobs.run_all(pow, {"a": (2, 3), "b": (2, 4)}, scheduler=cluster) == {"a": 8, "b": 16}
    done = []
    for name, _ in jobs.run(time.sleep, {str(number): (0.5,) for number in range(6)}, scheduler=cluster):
        if not done:
            os.kill(who.pop(), signal.SIGKILL)
        done.append(name)
    assert sorted(done) == ["0", "1", "2", "3", "4", "5"]


@pytest.mark.study
def test_scheduler_is_killed_and_the_same_jobs_are_completed_without_it(cluster: str, tmp_path: Path) -> None:
    from distributed import Client

    with Client(cluster) as client:
        scheduler = client.run_on_scheduler(os.getpid)
    wanted, results, done = {str(number): (0.5,) for number in range(8)}, tmp_path / "results", []
    with pytest.raises(UserError, match=f"the scheduler at {cluster} went away: the same command does what is missing"):
        for name, _ in jobs.run(time.sleep, wanted, scheduler=cluster, results_file=results):
            done.append(name)
            os.kill(scheduler, signal.SIGKILL)
    missing = jobs.run_all(
        max, {name: (*given, 0.0) for name, given in wanted.items()}, results_file=results, processes=1
    )
    assert [name for name in wanted if missing[name] is None] == sorted(done), "what was done is not done again"


def test_finished_jobs_are_not_done_again_and_after_a_full_disk_only_those_that_are_missing(tmp_path: Path) -> None:
    results, wanted = tmp_path / "results", {str(k): (2, k) for k in range(20)}
    with files_of_at_most(90), pytest.raises(OSError, match="File too large"):
        jobs.run_all(pow, wanted, results_file=results, processes=1)
    assert results.stat().st_size == 90 and not results.read_bytes().endswith(b"\n")
    assert jobs.run_all(pow, wanted, results_file=results, processes=1)["19"] == 2**19
    assert len(results.read_text().splitlines()) == 20
    again = jobs.run_all(divmod, {"4": (1, 0), "3": (1, 0), "new": (7, 2)}, results_file=results, processes=1)
    assert list(again.items()) == [("4", 16), ("3", 8), ("new", (3, 1))], "in this order"
