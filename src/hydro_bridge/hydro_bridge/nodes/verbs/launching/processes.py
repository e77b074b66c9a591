# SPDX-License-Identifier: Apache-2.0
"""Start and stop of a launch file's processes; stopped in reverse order, so that controllers end before the plant."""

from __future__ import annotations

import sys
import time
from collections.abc import Iterator

from hydro_bridge.cli.console import UserError
from hydro_bridge.nodes.verbs.launching.description import (
    ExecuteProcess,
    LaunchContext,
    LaunchDescriptionEntity,
)
from hydro_bridge.process.endings import undisturbed
from hydro_bridge.ros.companion import Companion

_LOOK = 0.1  # s


def processes(entity: LaunchDescriptionEntity, context: LaunchContext) -> Iterator[ExecuteProcess]:
    """Return all processes of a description whose conditions hold, in its order; raises UserError."""
    if entity.condition is not None and not entity.condition.evaluate(context):
        return
    if isinstance(entity, ExecuteProcess):
        yield entity
    for part in entity.visit(context):
        yield from processes(part, context)


def run(entity: LaunchDescriptionEntity, values: dict[str, str]) -> int:
    """Start all processes, and wait until all of them, or one that shuts down the others, have ended.

    Returns
    -------
    0, or 1 if a process that ended by itself had a non-zero exit status.

    Raises
    ------
    UserError
        An argument is missing or refused; nothing was started.
    CompanionError
        An executable is missing; the processes already started have been ended.
    """
    context = LaunchContext(values)
    wanted = list(processes(entity, context))
    planned = [(process, process.patience(context), process.command(context)) for process in wanted]
    if not planned:
        raise UserError("nothing is to be started")
    started: list[tuple[Companion, ExecuteProcess]] = []
    patience: dict[Companion, float] = {}
    try:
        for number, (process, seconds, (package, executable, words)) in enumerate(planned, 1):
            name = f"{executable}-{number}"
            companion = Companion(package, executable, words, name=name, output=sys.stdout)
            patience[companion] = seconds
            started.append((companion, process))
            print(f"[INFO] [{name}]: process started with pid [{companion.process.pid}]", flush=True)
        return _follow(started)
    finally:
        with undisturbed():
            for companion, _ in reversed(started):
                companion.stop(patience[companion])


def _follow(started: list[tuple[Companion, ExecuteProcess]]) -> int:
    running, failed = list(started), False
    while running:
        time.sleep(_LOOK)
        for companion, process in list(running):
            if companion.running:
                continue
            running.remove((companion, process))
            status = companion.process.returncode
            failed = failed or status != 0
            how = "process has finished cleanly" if status == 0 else f"process has died, exit code {status}"
            print(f"[{'ERROR' if status else 'INFO'}] [{companion.name}]: {how}", flush=True)
            if process.on_exit is not None:
                print(f"[INFO] [launch]: {process.on_exit.reason or 'shutdown'}", flush=True)
                return int(failed)
    return int(failed)
