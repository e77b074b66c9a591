# SPDX-License-Identifier: Apache-2.0
"""Events of a recording as marks of one sentence, from the flags of its samples and the messages of its nodes.

===========  ==========================================================================================
kind         from
===========  ==========================================================================================
armed        flag ARMED of /hydro/state, set or cleared
trip         flag TRIPPED, with the accompanying flags
watchdog     flag WATCHDOG: no commands for 50 ms
authority    /hydro/authority: change of holder
episode      /hydro/training: start of the next episode, and result of the last one
examination  /hydro/training: phase EVALUATING; "examination" in the trainer's diagnostics
phase        /hydro/training: any other change of the phase
learner      /hydro/training: the learner went down, or runs again
weights      /hydro/policy: change of the acting weights after a second without one
rollback     "rollbacks" in the trainer's diagnostics
override     "override" in the trainer's diagnostics: gains held by a person, to within 0.5 s
call         /rosout, names that end in `calls`: requests to arm, disarm or override, and the answers
log          /rosout: warnings and errors of all nodes
window       report.json of a diagnosis: where the recording and the model differ (`read_windows`)
===========  ==========================================================================================
"""

from __future__ import annotations

import json
import math
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags import RecordingError
from hydro_bridge.pages.series import PHASES
from hydro_core.signals import Flag, StateArray

MARKS_MAX = 20_000
"""Maximum number of marks of a page."""


def flag_labels(flags: int) -> list[str]:
    """Return the pages' names of the flags that are set."""
    return [str(flag.name).lower().replace("_", " ") for flag in Flag if flag & flags]


@dataclass(frozen=True)
class Mark:
    """Mark of one event."""

    time: float
    """s, on the clock of the samples."""
    kind: str
    text: str


class MarkCollector:
    """Collects the marks of a recording while it is read in order."""

    def __init__(self) -> None:
        self._marks: list[Mark] = []
        self._flags: int | None = None
        self._last = {"holder": "unknown"}
        self._weights, self._weights_changed = -1, -math.inf

    def crop(self, begin: float, seconds: float) -> list[Mark]:
        """Return the first marks from `begin` [s] for `seconds`, relative to `begin`; before them what held then."""
        marks = [replace(mark, time=round(mark.time - begin, 3)) for mark in self._marks]
        marks.sort(key=lambda mark: mark.time)
        held = {mark.kind: replace(mark, time=0.0) for mark in marks if mark.time < 0.0}
        shown = [held[kind] for kind in ("authority", "weights") if kind in held]
        return (shown + [mark for mark in marks if 0.0 <= mark.time <= seconds])[:MARKS_MAX]

    def add(self, time: float, kind: str, text: str) -> None:
        """Add a mark."""
        self._marks.append(Mark(time, kind, text))

    def add_states(self, states: StateArray) -> None:
        """Add the marks of `STATE_DTYPE` records, from their flags."""
        flags = states["flags"].astype(np.int64)
        if self._flags is None and flags[0] & Flag.ARMED:
            self.add(float(states["time"][0]), "armed", "armed already when the recording begins")
        before = np.concatenate(([flags[0] if self._flags is None else self._flags], flags[:-1]))
        for n in np.flatnonzero(flags != before):
            time, now = float(states["time"][n]), int(flags[n])
            risen, fallen = now & ~int(before[n]), int(before[n]) & ~now
            if risen & Flag.TRIPPED:
                others = ", ".join(flag_labels(risen & ~int(Flag.TRIPPED)))
                self.add(time, "trip", f"tripped{f': {others}' if others else ''}")
            if risen & Flag.ARMED:
                self.add(time, "armed", "armed")
            elif fallen & Flag.ARMED and not risen & Flag.TRIPPED:
                self.add(time, "armed", "disarmed")
            if risen & Flag.WATCHDOG and now & Flag.ARMED:
                self.add(time, "watchdog", "no commands for 50 ms: base gains")
        self._flags = int(flags[-1])

    def add_steps(self, times: npt.NDArray[np.float64], weights: npt.NDArray[np.int64]) -> None:
        """Add the changes of acting weights that come a second or more after the one before."""
        for n in np.flatnonzero(np.diff(weights, prepend=self._weights)):
            time, first = float(times[n]), ", the first to act" if self._weights < 0 else ""
            self._weights = int(weights[n])
            if time - self._weights_changed >= 1.0:
                self.add(time, "weights", f"weights {self._weights:012x}{first}")
            self._weights_changed = time

    def add_message(self, topic: str, time: float, message: Any) -> None:
        """Add a message of /hydro/authority, /hydro/training, /diagnostics or /rosout."""
        if topic == "/hydro/authority":
            if self._changed("holder", message.holder) is not None:
                told = f"commanded by {message.holder}" if message.holder else "no node commands the plant"
                self.add(time, "authority", told)
        elif topic == "/hydro/training":
            self._add_training(time, message)
        elif topic == "/diagnostics":
            for node in message.status:
                if node.name in ("trainer", "evaluate"):
                    self._add_diagnostics(time, node.name, {entry.key: entry.value for entry in node.values})
        elif message.name.endswith(".calls"):  # as in `hydro_bridge.ros.diagnostics`
            self.add(time, "call", f"{message.name.removesuffix('.calls')} was asked: {message.msg}")
        elif message.level >= 30:  # WARN
            self.add(time, "log", f"{message.name}: {message.msg}")

    def _add_training(self, time: float, message: Any) -> None:
        phase = PHASES[message.phase]
        if (before := self._changed("phase", phase)) is not None:
            ended = "examination ends, " if before == "evaluating" else ""
            self.add(time, "examination" if "evaluating" in (before, phase) else "phase", ended + phase)
        if self._changed("episode", str(message.episode)) is not None:
            result = f"; the last one: RMSE {message.force_rmse:.1f} N, return {message.episode_return:.0f}"
            self.add(time, "episode", f"episode {message.episode}{result if math.isfinite(message.force_rmse) else ''}")
        if self._changed("learner", str(message.learner_alive)) is not None:
            self.add(time, "learner", "the learner runs again" if message.learner_alive else "the learner is down")

    def _add_diagnostics(self, time: float, node: str, values: dict[str, str]) -> None:
        for key, kind, text in (
            ("rollbacks", "rollback", "rolled back to the best policy, {} times in all"),
            ("override", "override", "gains given back" if values.get("override") == "no" else "gains by hand: {}"),
            ("examination", "examination", "{}"),
        ):
            if key in values and self._changed(f"{node} {key}", values[key]) is not None:
                self.add(time, kind, text.format(values[key]))

    def _changed(self, key: str, now: str) -> str | None:
        """Return the value before a change; None at first and without one."""
        before, self._last[key] = self._last.get(key, now), now
        return before if before != now else None


def read_windows(report: Path, bag: Path, begin: float) -> list[Mark]:
    """Read the windows of one recording from a diagnosis' report.json; times are s from its first sample.

    It is the one whose first sample has the stamp `begin` [s]; ties are broken by the name. Raises RecordingError: the
    file cannot be read, or is not the report of a diagnosis.
    """
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
        begins = [(one["name"], one["begin"]) for one in content["recordings"]]
        alike = [name for name, start in begins if start is not None and abs(start - begin) < 1e-3]
        named = [name for name in alike if len(alike) == 1 or Path(name).name in (bag.name, bag.stem)]
        known = len(named) == 1 and [name for name, _ in begins].count(named[0]) == 1
        return [
            Mark(float(start), "window", f"{place['equation']}, for {end - start:.2f} s: {place['sentence']}")
            for place in content["location"]
            for start, end in (place["windows"].get(named[0], ()) if known else ())
        ]
    except OSError as error:
        raise RecordingError(f"{report}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise RecordingError(f"{report} is not a report of a diagnosis") from None
