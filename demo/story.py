# SPDX-License-Identifier: Apache-2.0
"""What has happened so far: controllers, where each was chosen, and how it does."""

from __future__ import annotations

from dataclasses import dataclass, field
from typing import Any

from demo import trial
from demo.stages import Plan


@dataclass(frozen=True, kw_only=True)
class Entry:
    """A controller, where it was chosen, and how it does."""

    name: str
    chosen: str
    """believed, corrected, or - for gains from elsewhere."""
    simulated: trial.Outcome
    bench: trial.Outcome


@dataclass
class Story:
    """What happened."""

    plan: Plan
    report: dict[str, Any] = field(default_factory=dict)
    entries: list[Entry] = field(default_factory=list)

    def tried(self, name: str) -> list[Entry]:
        """Entries of the trainings called `name`."""
        return [entry for entry in self.entries if entry.name.startswith(name)]
