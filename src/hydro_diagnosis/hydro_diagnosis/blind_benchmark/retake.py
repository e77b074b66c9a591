# SPDX-License-Identifier: Apache-2.0
"""Retakes of unusable runs, decided from the run alone, as an operator would.

First come lower gains and a smaller reference. If the bench still trips or swings from stop to stop, the box assumes a
stronger valve: its force law then compensates the velocity term only in part, and the loop is damped again. The box's
assumption does not concern the diagnosis, which reads the recorded valve current.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from hydro_bridge.bags.recording import read_bag
from hydro_bridge.signals import Flag
from hydro_diagnosis.io.table import UnusableRecordingError, read_table
from hydro_diagnosis.preprocessing.quality import checked
from hydro_sim.model.bench import Bench

USED = 0.5
"""Share of a run that must be free of end stops and cavitation."""
SATURATED = 0.01
"""Share of a run in which the valve current may stand at its limit."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """Settings of one attempt at a run."""

    amplitude: float = 1.0
    """Share of the drawn reference's amplitude."""
    kp: float = 1e3
    """Upper limit [1/s] of the drawn K_p."""
    ki: float = 1e3
    """Upper limit [1/s^2] of the drawn K_i."""
    believed_flow: float = 1.0
    """`valve_nominal_flow` that the box assumes, over that of bench.yaml."""

    def schedule(self, drawn: Mapping[str, Any]) -> dict[str, Any]:
        """Reference and gains of this attempt."""
        gains = {"kp": min(self.kp, drawn["kp"]), "ki": min(self.ki, drawn["ki"])}
        return {**drawn, "amplitude": self.amplitude * drawn["amplitude"], **gains}

    def box(self) -> Bench | None:
        """Bench that the box assumes; None: bench.yaml unchanged."""
        if self.believed_flow == 1.0:
            return None
        bench = Bench.nominal()
        return replace(bench, valve_nominal_flow=self.believed_flow * bench.valve_nominal_flow)


ATTEMPTS = (
    Attempt(),
    Attempt(amplitude=0.6, kp=30.0, ki=5.0),
    Attempt(believed_flow=1.25),
    Attempt(believed_flow=1.6, amplitude=0.6),
    Attempt(believed_flow=2.5, amplitude=0.6),
)
"""Tried in order until a run is usable; the last one is kept in any case."""


def usable(bag: Path) -> bool:
    """Return whether the box did not trip, the valve hardly saturated, and the stops were mostly left alone."""
    flags = read_bag(bag, topics=("/hydro/state",)).state["flags"]
    if (flags & Flag.TRIPPED).any() or np.mean((flags & Flag.SATURATED) > 0) > SATURATED:
        return False
    try:
        recording = checked(read_table(bag), Bench.nominal())
    except UnusableRecordingError:
        return False
    return recording.seconds >= USED * 1e-3 * len(flags)
