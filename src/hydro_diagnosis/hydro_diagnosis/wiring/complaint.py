# SPDX-License-Identifier: Apache-2.0
"""Result of a failed wiring check, with the mistakes that would explain it."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass

import numpy as np

from hydro_diagnosis.wiring.repairs import Channels, Repair
from hydro_sim.model.bench import Bench

AGAINST = -0.5
"""Correlation below which two channels go against each other."""
TOGETHER = 0.9
"""Correlation above which their sizes can be compared."""
VELOCITY = 0.8
"""Correlation with the rate of the load's force, and with the current, above which a position is a velocity."""
SIZE = 3.0
"""Times by which forces may differ from what pressures or spring make."""
MOVES = 1e-3
"""Share of the stroke: a piston that moves less shows neither sign nor size."""


@dataclass(frozen=True)
class Complaint:
    """A contradiction that no bench shows."""

    sentence: str
    suspects: tuple[Repair, ...]
    """Mistakes that would explain it, the likeliest first."""


Check = Callable[[Channels, float, Bench], Iterator[Complaint]]


def stands(channels: Channels, bench: Bench) -> bool:
    """Return whether the piston hardly moves, so that nothing can be said of how channels go with it."""
    if "piston_position" not in channels:
        return False
    return float(np.ptp(channels["piston_position"])) < MOVES * bench.stroke
