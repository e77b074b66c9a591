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
from hydro_core.errors import UserError, is_user_error, user_message

JobArguments = Mapping[str, tuple[Any, ...]]
"""Arguments of each job, by its name."""
JobResults = Generator[tuple[str, Any, Exception | None], None, None]
WORKER_DEATHS_MAX = 3
"""Worker processes that one job may kill before it counts as failed."""
DASK_SETTINGS = {
    "distributed.scheduler.allowed-failures": 0,
    "distributed.nanny.pre-spawn-environ": {"OMP_NUM_THREADS": 1, "MKL_NUM_THREADS": 1, "OPENBLAS_NUM_THREADS": 1},
}
"""Dask settings, without its MALLOC_TRIM_THRESHOLD_, by which large arrays cost four times the processor time."""


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

    `processes`: number on this machine; 0: one a core. `scheduler`: address of a Dask scheduler whose workers run the
    jobs instead. `results_file`: file of results, a line of JSON for each job: jobs in it are not run again.

    Raises UserError at the end, if jobs failed; each is reported on standard error when it fails.
    """
    found: dict[str, Any] = {}
    if results_file is not None and results_file.exists():
        content = results_file.read_bytes()
        whole = content[: content.rfind(b"\n") + 1]
        os.truncate(results_file, len(whole))  # a last line may be cut off, by a full disk or a kill
        found = {entry["key"]: entry["value"] for entry in map(json.loads, whole.splitlines())}
    missing = {name: values for name, values in arguments.items() if name not in found}
    yield from ((name, found[name]) for name in arguments if name in found)
    processes = min(processes or len(os.sched_getaffinity(0)), len(missing))
    alone = not missing or (processes == 1 and scheduler is None)
    results = _here(function, missing) if alone else _on_dask(function, missing, processes, scheduler)
    errors = set[str]()
    bar: tqdm[Any] = progress(total=len(missing), label=label, unit=unit, every=60.0)
    with closing(results), bar:
        for name, value, error in results:
            bar.update()
            if error is not None:
                errors.add(name)
                told = user_message(error) if is_user_error(error) else "".join(format_exception(error)).rstrip()
                bar.write(f"{name}: {told}", file=sys.stderr)
                continue
            if results_file is not None:
                with results_file.open("a", encoding="utf-8") as file:
                    file.write(json.dumps({"key": name, "value": value}) + "\n")
            yield name, value
    if errors:
        failed = ", ".join([name for name in arguments if name in errors][:10])
        raise UserError(f"{len(errors)} of {len(arguments)} jobs failed: {failed}; the others are done")


def run_all(function: Callable[..., Any], arguments: JobArguments, **how: Any) -> dict[str, Any]:
    """Return the results of `run` by name, in the order of the names."""
    found = dict(run(function, arguments, **how))
    return {name: found[name] for name in arguments}


def _here(function: Callable[..., Any], missing: JobArguments) -> JobResults:
    for name, values in missing.items():
        try:
            yield name, function(*values), None
        except Exception as error:
            yield name, None, error


def _on_dask(
    function: Callable[..., Any], missing: JobArguments, processes: int, scheduler: str | None
) -> JobResults:  # fmt: skip
    import dask
    from distributed import CancelledError, Client, KilledWorker, LocalCluster, as_completed

    with ExitStack() as stack:
        stack.enter_context(dask.config.set(DASK_SETTINGS))
        local = {"n_workers": processes, "threads_per_worker": 1, "dashboard_address": "127.0.0.1:0"}
        try:
            address = scheduler or stack.enter_context(LocalCluster(**local, silence_logs=CRITICAL))
            client = stack.enter_context(Client(address, timeout=10.0))
            client.wait_for_workers(1, timeout=600.0)  # a cluster's queue may delay the first
        except (OSError, ValueError) as error:
            raise UserError(f"no scheduler with workers answers at {scheduler}: {error}") from error
        waiting, sent, deaths, done = deque(missing), dict[str, str](), Counter[str](), as_completed()

        def send() -> None:
            """Send a job for each idle worker: if one is killed, it was by its only job."""
            while waiting and len(sent) < max(1, sum(client.nthreads().values())):
                future = client.submit(function, *missing[waiting[0]], pure=False)
                sent[future.key] = waiting.popleft()
                done.add(future)

        try:
            send()
            for future in done:
                name, failure = sent.pop(future.key), future.exception()
                value = None if failure else future.result()
                future.release()  # its worker need not keep the result
                if isinstance(failure, KilledWorker):
                    deaths[name] += 1
                    if deaths[name] < WORKER_DEATHS_MAX:
                        waiting.append(name)
                        send()
                        continue
                    failure = UserError("it killed each process that did it: it may need more memory than a worker has")
                send()
                yield name, value, failure
        except (OSError, CancelledError) as error:
            if scheduler is None:
                raise
            raise UserError(f"the scheduler at {scheduler} went away: the same command does what is missing") from error
