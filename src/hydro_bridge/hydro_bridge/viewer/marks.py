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
weights      /hydro/policy: change of the acting weights (`MarkCollector.add_steps`)
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
from collections import Counter
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags.types import RecordingError
from hydro_bridge.dashboard.status import PHASES, flag_labels
from hydro_core.cli.console import plural
from hydro_core.signals import Flag, StateArray

DEBOUNCE_TIME = 1.0
"""s without a change of weights after which the next change is marked; other changes are only counted."""


MARKS_MAX = 20_000
"""Maximum number of marks; later ones are counted, not kept."""

CALL_LOGGER = "calls"
"""Name of call messages, as in `hydro_bridge.ros.diagnostics`."""
_TRAINER_NODES = ("trainer", "evaluate")
_WARN_LEVEL = 30


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
        self.dropped = 0
        """Marks beyond `MARKS_MAX`."""
        self._marks: list[Mark] = []
        self._flags: int | None = None
        self._holder: str | None = None
        self._episode, self._phase, self._learner = -1, -1, True
        self._said: dict[str, str] = {}
        self._weights: int | None = None
        self._weights_changed, self._weight_changes = 0.0, 0

    def crop(self, begin: float, seconds: float) -> list[Mark]:
        """Return the marks from `begin` [s] for `seconds`, in order, relative to `begin`; first the lease's holder."""
        marks = sorted(self._marks, key=lambda mark: mark.time)
        held = [mark for mark in marks if mark.kind == "authority" and mark.time < begin][-1:]
        shown = [Mark(begin, mark.kind, mark.text) for mark in held] + [mark for mark in marks if mark.time >= begin]
        return [Mark(mark.time - begin, mark.kind, mark.text) for mark in shown if mark.time - begin <= seconds]

    def add_states(self, states: StateArray) -> None:
        """Add the marks of `STATE_DTYPE` records, from their flags."""
        if not len(states):
            return
        flags = states["flags"].astype(np.int64)
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
        if self._flags is None and flags[0] & Flag.ARMED:
            self.add(float(states["time"][0]), "armed", "armed already when the recording begins")
        self._flags = int(flags[-1])

    def add_authority(self, time: float, holder: str) -> None:
        """Add the holder of the lease from `time` on; empty: none."""
        if holder != self._holder:
            self.add(time, "authority", f"commanded by {holder}" if holder else "no node commands the plant")
        self._holder = holder

    def add_training(self, message: Mapping[str, Any]) -> None:
        """Add the fields of a TrainingStatus, with `time` [s]."""
        time, phase, episode = float(message["time"]), int(message["phase"]), int(message["episode"])
        if phase != self._phase and self._phase >= 0:
            evaluating = PHASES.index("evaluating")
            if evaluating in (self._phase, phase):
                self.add(time, "examination", f"examination {'begins' if phase == evaluating else 'ends'}")
            elif phase < len(PHASES):
                self.add(time, "phase", PHASES[phase])
        if episode != self._episode and self._episode >= 0:
            rmse, total = float(message["force_rmse"]), float(message["episode_return"])
            came_to = f"; the last one: RMSE {rmse:.1f} N, return {total:.0f}" if math.isfinite(rmse) else ""
            self.add(time, "episode", f"episode {episode}{came_to}")
        if bool(message["learner_alive"]) != self._learner:
            self.add(time, "learner", "the learner runs again" if message["learner_alive"] else "the learner is down")
        self._phase, self._episode, self._learner = phase, episode, bool(message["learner_alive"])

    def add_steps(self, steps: npt.NDArray[np.void]) -> None:
        """Add the changes of weights in PolicyStep records, with `time` [s], named as in the trainer's diagnostics."""
        if not len(steps):
            return
        times, weights = steps["time"], steps["weights"]
        if self._weights is None:
            self._weights_changed, self._weights = float(times[0]), int(weights[0])
            self.add(self._weights_changed, "weights", f"weights {self._weights:012x}, the first to act")
        before = np.concatenate((np.array([self._weights], weights.dtype), weights[:-1]))
        for n in np.flatnonzero(weights != before):
            time, self._weight_changes = float(times[n]), self._weight_changes + 1
            if time - self._weights_changed >= DEBOUNCE_TIME:
                often = f"{plural(self._weight_changes, 'change')} since the mark before"
                self.add(time, "weights", f"weights {int(weights[n]):012x}, {often}")
                self._weight_changes = 0
            self._weights_changed = time
        self._weights = int(weights[-1])

    def add_diagnostics(self, time: float, name: str, values: Mapping[str, str]) -> None:
        """Add the marks of a diagnostics status of the node `name`."""
        if name not in _TRAINER_NODES:
            return
        for key, (kind, sentence) in _DIAGNOSTIC_MARKS.items():
            if key not in values:
                continue
            now, before = values[key], self._said.get(f"{name} {key}")
            self._said[f"{name} {key}"] = now
            if before is not None and now != before:
                self.add(time, kind, sentence(now))

    def add_log(self, time: float, level: int, name: str, sentence: str) -> None:
        """Add the mark of a message of /rosout by its level, as numbered in rcl_interfaces/Log."""
        node, _, last = name.rpartition(".")
        if last == CALL_LOGGER:
            self.add(time, "call", f"{node} was asked: {sentence}")
        elif level >= _WARN_LEVEL:
            self.add(time, "log", f"{name}: {sentence}")

    def add(self, time: float, kind: str, text: str) -> None:
        """Add a mark."""
        if len(self._marks) < MARKS_MAX:
            self._marks.append(Mark(time, kind, text))
        else:
            self.dropped += 1


_DIAGNOSTIC_MARKS: dict[str, tuple[str, Callable[[str], str]]] = {
    "rollbacks": ("rollback", lambda said: f"rolled back to the best policy, {said} times in all"),
    "override": ("override", lambda said: "gains given back" if said == "no" else f"gains by hand: {said}"),
    "examination": ("examination", lambda said: said),
}
"""Kind and text of the mark for a new value under a key of the trainer's diagnostics."""


REPORT_FILE = "report.json"
_SAME_SAMPLE_TIME = 1e-3  # s between two stamps of one sample


ReportWindows = list[tuple[str, float | None, list[Mark]]]
"""Name of each recording of a report, stamp [s] of the first sample of a bag, and its windows, in s from that."""


def select_windows(windows: ReportWindows, bag: Path, begin: float) -> list[Mark]:
    """Return the windows of the recording whose first sample has the stamp `begin` [s]; ties are broken by name."""
    alike = [entry for entry in windows if entry[1] is not None and abs(entry[1] - begin) < _SAME_SAMPLE_TIME]
    named = [entry for entry in alike if len(alike) == 1 or Path(entry[0]).name in (bag.name, bag.stem)]
    return named[0][2] if len(named) == 1 else []


def read_windows(report: Path) -> ReportWindows:
    """Read the windows of each recording from a diagnosis' report.json.

    Raises RecordingError: the file cannot be read, or is not the report of a diagnosis.
    """
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
        marks: dict[str, list[Mark]] = {}
        for place in content["location"]:
            for name, stretches in place["windows"].items():
                marks.setdefault(name, []).extend(
                    Mark(float(begin), "window", f"{place['equation']}, for {end - begin:.2f} s: {place['sentence']}")
                    for begin, end in stretches
                )
        begins = [(entry["name"], entry["begin"]) for entry in content["recordings"]]
        told = Counter(name for name, _ in begins)  # windows under a name that two share are of either
        return [(name, begin, marks.get(name, [])) for name, begin in begins if told[name] == 1]
    except OSError as error:
        raise RecordingError(f"{report}: {error.strerror}") from None
    except (ValueError, KeyError, TypeError, AttributeError):
        raise RecordingError(f"{report} is not a report of a diagnosis") from None
