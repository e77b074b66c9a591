# SPDX-License-Identifier: Apache-2.0
"""Records compilations at run time; there should be none after set-up (`make setup`).

Where the environment variable HYDRO_COMPILATIONS names a file, each compilation appends one line of JSON to it:

    {"program": "trainer", "process": 4711, "function": "hydro_policy.sac.algorithm.learn", "seconds": 7.3}

A function that comes from numba's cache appends none. One that is compiled inside of another has a line of its own,
and the outer one's time holds it.
"""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path
from time import monotonic
from typing import Any

VARIABLE = "HYDRO_COMPILATIONS"


def record_compilations() -> None:
    """Start recording if the environment asks for it. Call it once, before anything is compiled."""
    name = os.environ.get(VARIABLE)
    if not name:
        return
    file = Path(name)
    from numba.core import event  # takes half a second: only where it is needed

    class _Recorder(event.Listener):
        def __init__(self) -> None:
            self._begun: list[float] = []

        def on_start(self, event: Any) -> None:
            self._begun.append(monotonic())

        def on_end(self, event: Any) -> None:
            _append(file, event.data["dispatcher"], monotonic() - self._begun.pop())

    event.register("numba:compile", _Recorder())


def read_compilations(file: Path) -> list[dict[str, Any]]:
    """Recorded compilations; empty if there is no such file."""
    return [json.loads(line) for line in file.read_text().splitlines()] if file.exists() else []


def _append(file: Path, dispatcher: Any, seconds: float) -> None:
    function = dispatcher.py_func
    line = {
        "program": Path(sys.argv[0]).name,
        "process": os.getpid(),
        "function": f"{function.__module__}.{function.__qualname__}",
        "seconds": round(seconds, 3),
    }
    with file.open("a") as out:  # one short write: lines of several processes do not mix
        out.write(json.dumps(line) + "\n")
