# SPDX-License-Identifier: Apache-2.0
"""Parallel jobs on this machine's cores, or on the workers of a Dask scheduler (`many_jobs.md`).

for name, result in jobs.run(trial, {"trial 7": (bench, 7), "trial 8": (bench, 8)}):  # in order of completion
    ...

A job is a function of plain values, its seed among them: the result does not depend on the process that computes it. A
single job, or all jobs on a single core, run in this process. Otherwise Dask's distributed, imported only then, runs
one process a core, and repeats a job whose process was killed.
"""

from __future__ import annotations

import argparse
import json
import os
import sys
from collections import Counter, deque
from collections.abc import Callable, Generator, Iterator, Mapping
from contextlib import ExitStack, closing
from logging import CRITICAL
from pathlib import Path
from traceback import format_exception
from typing import Any

from tqdm import tqdm

from hydro_core.cli.console import bounded_number, progress
from hydro_core.errors import UserError, is_file_error, user_message

JobArguments = Mapping[str, tuple[Any, ...]]
"""Arguments of each job, by its name."""
JobResults = Generator[tuple[str, Any, Exception | None], None, None]
SCHEDULER_TIMEOUT, WORKER_TIMEOUT = 10.0, 600.0
"""Time-outs [s] for a scheduler's answer, and for its first worker, which a cluster's queue may delay."""
DASK_SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 1, "MKL_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1},
}
"""Dask settings, without its MALLOC_TRIM_THRESHOLD_, by which large arrays cost four times the processor time."""
MAX_WORKER_DEATHS = 3
"""Worker processes that one job may kill before it counts as failed."""


class JobsError(UserError):
    """Error of a run with failed jobs, raised after all others are done; `errors`: their exceptions by job name."""

    def __init__(self, errors: Mapping[str, Exception], count: int) -> None:
        named = ", ".join(errors) if len(errors) < 10 else f"{', '.join([*errors][:8])} and {len(errors) - 8} more"
        super().__init__(f"{len(errors)} of {count} jobs failed: {named}; the others are done")
        self.errors = errors


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Add the options `--jobs N` and `--scheduler ADDRESS`."""
    parser.add_argument(
        "--jobs", type=bounded_number(1), default=0, metavar="N", help="jobs at once (default: one a core)"
    )
    parser.add_argument("--scheduler", metavar="ADDRESS", help="of a cluster that does them instead (many_jobs.md)")


def job_options(asked: argparse.Namespace) -> dict[str, Any]:
    """Return the options as keyword arguments of `run` and `run_all`."""
    return {"processes": asked.jobs, "scheduler": asked.scheduler}


def run(
    function: Callable[..., Any], arguments: JobArguments, *, processes: int = 0, scheduler: str | None = None,
    results_file: Path | None = None, label: str = "jobs", unit: str = "job",
) -> Iterator[tuple[str, Any]]:  # fmt: skip
    """Yield name and result, `function(*arguments[name])`, of each job as it ends.

    Parameters
    ----------
    processes
        Number of processes on this machine; 0: one a core.
    scheduler
        Address of a Dask scheduler whose workers run the jobs instead.
    results_file
        File of results, a line of JSON for each job: jobs in it are not run again, new results are appended.

    Raises
    ------
    JobsError
        At the end, if jobs failed. Each is reported on standard error when it fails.
    """
    found: dict[str, Any] = {}
    if results_file is not None and results_file.exists():
        content = results_file.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        if whole != content:  # a last line that was cut off, by a full disk or a kill
            os.truncate(results_file, len(whole))
        found = {entry["key"]: entry["value"] for entry in map(json.loads, whole.splitlines())}
    missing = {name: values for name, values in arguments.items() if name not in found}
    yield from ((name, found[name]) for name in arguments if name in found)
    processes = min(processes or len(os.sched_getaffinity(0)), len(missing))
    alone = not missing or (processes == 1 and scheduler is None)
    results = _here(function, missing) if alone else _side_by_side(function, missing, processes, scheduler)
    errors: dict[str, Exception] = {}
    bar: tqdm[Any] = progress(total=len(missing), label=label, unit=unit, every=60.0, delay=60.0)
    with closing(results), bar:
        for name, value, error in results:
            bar.update()
            if error is not None:
                errors[name] = error
                correctable = isinstance(error, UserError) or is_file_error(error)
                told = user_message(error) if correctable else "".join(format_exception(error)).rstrip()
                bar.write(f"{name}: {told}", file=sys.stderr)
                continue
            if results_file is not None:
                with results_file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"key": name, "value": value}) + "\n")
            yield name, value
    if errors:
        raise JobsError({name: errors[name] for name in arguments if name in errors}, len(arguments))


def run_all(function: Callable[..., Any], arguments: JobArguments, **how: Any) -> dict[str, Any]:
    """Return the results of `run` by name, in the order of the names."""
    found = dict(run(function, arguments, **how))
    return {name: found[name] for name in arguments}


def _here(function: Callable[..., Any], missing: JobArguments) -> JobResults:
    for name, values in missing.items():
        try:
            value = function(*values)
        except Exception as error:
            yield name, None, error
        else:
            yield name, value, None


def _side_by_side(
    function: Callable[..., Any], missing: JobArguments, processes: int, scheduler: str | None
) -> JobResults:
    """A worker has one job at a time: if it is killed, it was by that one."""
    import dask
    from distributed import CancelledError, Client, KilledWorker, LocalCluster, as_completed

    local = {"n_workers": processes, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0",
             "silence_logs": CRITICAL}  # fmt: skip
    with ExitStack() as stack:
        stack.enter_context(dask.config.set(DASK_SETTINGS))
        try:
            address = scheduler or stack.enter_context(LocalCluster(**local))
            client = stack.enter_context(Client(address, timeout=SCHEDULER_TIMEOUT))
            client.wait_for_workers(1, timeout=WORKER_TIMEOUT)
        except (OSError, ValueError) as error:
            raise UserError(f"no scheduler with workers answers at {scheduler}: {error}") from error
        sent: dict[str, str] = {}
        waiting, deaths, done = deque(missing), Counter[str](), as_completed()

        def send() -> None:
            while waiting and len(sent) < max(1, sum(client.nthreads().values())):
                future = client.submit(function, *missing[waiting[0]], pure=False)
                sent[future.key] = waiting.popleft()
                done.add(future)

        try:
            send()
            for future in done:
                name, failure = sent.pop(future.key), future.exception()
                value = future.result() if failure is None else None
                future.release()  # its worker need not keep the result
                if isinstance(failure, KilledWorker):
                    failure = UserError(
                        "each process that did it was killed: it may need more memory than a worker has"
                    )
                    deaths[name] += 1
                    if deaths[name] < MAX_WORKER_DEATHS:
                        waiting.append(name)
                        send()
                        continue
                send()
                yield name, value, failure
        except (OSError, CancelledError) as error:
            if scheduler is None:
                raise
            raise UserError(f"the scheduler at {scheduler} went away: the same command does what is missing") from error
