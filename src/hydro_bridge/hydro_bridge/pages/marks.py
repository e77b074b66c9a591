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
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import numpy.typing as npt

from hydro_bridge.bags.types import RecordingError
from hydro_bridge.pages.status import PHASES, flag_labels
from hydro_core.signals import Flag, StateArray

MARKS_MAX = 20_000
"""Maximum number of marks; later ones are counted, not kept."""


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
        self._said: dict[str, str] = {}
        self._weights, self._weights_changed = -1, 0.0

    def crop(self, begin: float, seconds: float) -> list[Mark]:
        """Return the marks from `begin` [s] for `seconds`, in order, relative to `begin`; first the lease's holder."""
        marks = sorted(self._marks, key=lambda mark: mark.time)
        held = [mark for mark in marks if mark.kind == "authority" and mark.time < begin][-1:]
        shown = [Mark(begin, mark.kind, mark.text) for mark in held] + [mark for mark in marks if mark.time >= begin]
        return [Mark(mark.time - begin, mark.kind, mark.text) for mark in shown if mark.time - begin <= seconds]

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

    def add_training(self, time: float, message: npt.NDArray[np.void]) -> None:
        """Add a TrainingStatus record."""
        phase = PHASES[message["phase"]] if message["phase"] < len(PHASES) else str(message["phase"])
        if (before := self._changed("phase", phase)) is not None:
            ended = "examination ends, " if before == "evaluating" else ""
            self.add(time, "examination" if "evaluating" in (before, phase) else "phase", ended + phase)
        if self._changed("episode", str(message["episode"])) is not None:
            rmse, total = float(message["force_rmse"]), float(message["episode_return"])
            came_to = f"; the last one: RMSE {rmse:.1f} N, return {total:.0f}" if math.isfinite(rmse) else ""
            self.add(time, "episode", f"episode {message['episode']}{came_to}")
        if self._changed("learner", str(message["learner_alive"])) is not None:
            self.add(time, "learner", "the learner runs again" if message["learner_alive"] else "the learner is down")

    def add_steps(self, times: npt.NDArray[np.float64], weights: npt.NDArray[np.int64]) -> None:
        """Add the changes of acting weights that come a second or more after the one before."""
        for n in np.flatnonzero(np.diff(weights, prepend=self._weights)):
            time, digest = float(times[n]), f"weights {int(weights[n]):012x}"
            if self._weights < 0:
                self.add(time, "weights", f"{digest}, the first to act")
            elif time - self._weights_changed >= 1.0:
                self.add(time, "weights", digest)
            self._weights_changed, self._weights = time, int(weights[n])

    def add_message(self, time: float, message: Any) -> None:
        """Add a message of /hydro/authority, /diagnostics or /rosout."""
        if hasattr(message, "holder"):
            if message.holder != self._said.get("holder"):
                told = f"commanded by {message.holder}" if message.holder else "no node commands the plant"
                self.add(time, "authority", told)
            self._said["holder"] = message.holder
        elif hasattr(message, "status"):
            for node in message.status:
                if node.name in ("trainer", "evaluate"):
                    self._add_diagnostics(time, node.name, {entry.key: entry.value for entry in node.values})
        else:
            node, _, last = message.name.rpartition(".")
            if last == "calls":  # as in `hydro_bridge.ros.diagnostics`
                self.add(time, "call", f"{node} was asked: {message.msg}")
            elif message.level >= 30:  # WARN
                self.add(time, "log", f"{message.name}: {message.msg}")

    def _add_diagnostics(self, time: float, node: str, values: Mapping[str, str]) -> None:
        said = values.get("override", "")
        texts = {
            "rollbacks": ("rollback", f"rolled back to the best policy, {values.get('rollbacks')} times in all"),
            "override": ("override", "gains given back" if said == "no" else f"gains by hand: {said}"),
            "examination": ("examination", values.get("examination", "")),
        }
        for key, (kind, text) in texts.items():
            if key in values and self._changed(f"{node} {key}", values[key]) is not None:
                self.add(time, kind, text)

    def _changed(self, key: str, now: str) -> str | None:
        """Return what was said before where it was something else; None the first time."""
        before, self._said[key] = self._said.get(key, now), now
        return before if before != now else None

    def add(self, time: float, kind: str, text: str) -> None:
        """Add a mark."""
        if len(self._marks) < MARKS_MAX:
            self._marks.append(Mark(time, kind, text))
        else:
            self.dropped += 1


def read_windows(report: Path, bag: Path, begin: float) -> list[Mark]:
    """Read the windows of one recording from a diagnosis' report.json; times are s from its first sample.

    It is the one whose first sample has the stamp `begin` [s]; ties are broken by the name. Raises RecordingError: the
    file cannot be read, or is not the report of a diagnosis.
    """
    try:
        content = json.loads(report.read_text(encoding="utf-8"))
        begins = [(one["name"], math.nan if one["begin"] is None else one["begin"]) for one in content["recordings"]]
        alike = [name for name, start in begins if abs(start - begin) < 1e-3]
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
