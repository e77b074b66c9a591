# SPDX-License-Identifier: Apache-2.0
"""What compiled code knows of effects: the program (constant) and the memory (what has a past).

A program is a list of entries, grouped by the hook in which they act and in the order of the bench file within it::

    entry     0          1          2            3          4
    kind      OFFSET     HARD       LAMINAR      COULOMB    GAIN             which branch of the hook's function
    value     [2e-4 ..]  [5e-4 ..]  [1e-13 ..]   [12 ..]    [1.02, 1 ..]     its numbers
    first     COMMAND: 0            FLOWS: 2     DRAG: 3    MEASURE: 4       where each hook's entries begin
"""

from __future__ import annotations

import numpy as np

COMMAND, OPENINGS, SUPPLY, FLOWS, STIFFNESS, DRAG, RESISTANCE, LOAD, LAG, MEASURE = range(10)
"""The hooks, in the order in which they act on the way from current to measurement."""

HOOKS = 10
CAPACITY = 24
"""Entries that a program can hold."""

WIDTH = 9
"""Numbers that an entry can hold."""

SUBSTEPS = 20
"""Runge-Kutta steps per sample, as without effects."""

HISTORY = 64
"""Samples of valve current that are remembered; dead times add up to less."""

EFFECTS_DTYPE = np.dtype(
    [("active", np.int64), ("delay", np.float64), ("first", np.int64, (HOOKS + 1,))]
    + [("kind", np.int64, (CAPACITY,)), ("value", np.float64, (CAPACITY, WIDTH))]
)
"""`active`: 0 for a bench without effects; `delay` in samples."""

MEMORY_DTYPE = np.dtype(
    [("samples", np.int64), ("current", np.float64, (HISTORY,)), ("lag", np.float64, (CAPACITY, 2))]
    + [("input", np.float64, (CAPACITY,)), ("demand", np.float64), ("bristle", np.float64)]
    + [("bristle_position", np.float64), ("dragged", np.float64)]
)
"""Since reset: samples, currents [A] (latest first), low-passes with their last input, lagged supply flow [m3/s],
bristle force [N] and where it was taken [m], position [m] of what is dragged through the load's gap."""
