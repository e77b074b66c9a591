# SPDX-License-Identifier: Apache-2.0
"""Data structures of a bench file's loop for compiled code: its two models, the box, the workspace of one sample.

They are filled in by `loop.loop_of` and `loop.step_of`.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
import numpy.typing as npt

from hydro_core.signals import FloatArray
from hydro_sim.model.plant import STATES_MAX

NONE = -1
"""Index that marks a state which the bench does not have."""

MEMORY_DTYPE = np.dtype(
    [("hidden", np.float64, (STATES_MAX + 2,)), ("reference_rate", np.float64), ("current", np.float64),
     ("running", np.bool_)], align=True,
)  # fmt: skip
"""What is remembered of one bench: the whole model's states, behind them the valve's opening [A] and its rate [A/s];
the last f_r' [N/s]; the current [A] of the last sample; whether it ran."""


class ModelParts(NamedTuple):
    """Constants of the two models for compiled code; created by `loop.loop_of`."""

    sample_at: int
    sample_k: FloatArray
    """Coefficients of the sample: those of a mass that the forces within it do not accelerate."""
    rates_at: int
    k: FloatArray
    loop_rates_at: int
    loop_jacobian_at: int
    loop_k: FloatArray
    from_whole: npt.NDArray[np.int64]
    """Index in the whole model of each state of the loop's model."""
    rest: FloatArray
    """State of the whole model at rest."""
    spool: int
    """Of the whole model; `NONE`: the spool is where the current puts it."""
    spool_rate: int
    loop_spool: int
    loop_spool_rate: int
    before: float
    """A, null shift between current and spool."""
    after: float
    """A, null shift behind the spool's lag."""
    cell: int
    """What the load cell shows, and its rate, of the whole model."""
    cell_rate: int
    loop_cell: int
    loop_cell_rate: int
    lagging: npt.NDArray[np.int64]
    """Rows, one of each lagging pressure sensor: what it shows, its rate, the pressure (0 or 1); whole model."""
    observer: FloatArray
    """`terms.pressure_observer`."""
    sensor_ages: FloatArray
    """s, 2 d/w of each lagging pressure sensor."""
    direct: FloatArray
    """Shape (2,): 1 where a pressure's reading is the pressure, 0 where its sensor lags."""
    kept: npt.NDArray[np.int64]
    """Numbers in the loop's model of the coordinates beside the eight (`terms`)."""
    on_their_way: int
    """Of these, the last are this many currents."""
    past: int
    """Past currents at the end of either model's states."""
    at_valve: int
    """Of the past currents, the one that is at the valve as a sample ends."""
    delay: float
    """s, dead time."""
    spool_age: float
    """s, 2 d/w of the valve's lag, by which its spool is behind."""
    force_shown: int
    """What a lagging load cell of f_h shows; `NONE`: the force itself."""
    lag: float
    """s, s^2: of the load cell, 2 d/w and 1/w^2."""
    inertia: float
    gain: FloatArray
    """Shape (5,): of the readings."""
    bias: FloatArray
    area: float
    ratio: float
    mass: float
    positions: FloatArray
    """m, and the load there [N]: rises."""
    forces: FloatArray
    holds: bool
    """Whether dry friction, without bristles, can hold the piston."""
    level: float
    """N, up to which dry friction holds, bristles or not."""
    least_gain: float
    """N/s/A: a chamber at its limit has no gain."""
    least_opening: float
    """A, at which the gain is taken where the valve is closed."""
    bend_max: float
    """N/s^2, limit of f_r'': that of a switched reference is arbitrary."""
    creep: float
    """m/s, below which the sign of a velocity is noise: dry friction that holds counts by its share of this."""
    allowed: FloatArray
    """N, N, N, Pa, Pa in a sample: what the equations of `innovations` may be off, whatever moves; shape (5,)."""
    memories: FloatArray
    """Of the box's differentiators: force rates, velocity."""
    slopes: int
    """Largest number of rates of either model."""


class Loop(NamedTuple):
    """A bench file's loop under a box, in the form of compiled code; created by `loop.loop_of`."""

    model: ModelParts
    bench: npt.NDArray[np.void]
    """Constants assumed by the box's force law, shape (1,)."""
    gain_floor: float
    """N/s/A, smallest g that the force law believes."""
    current_max: float
    """A."""
    scale: FloatArray
    """Shape (n,): of the eight coordinates and of those added."""


class Step(NamedTuple):
    """One sample of the loop, linearized, in units of `Loop.scale`, and scratch; created by `loop.step_of`."""

    transition: FloatArray
    """F, shape (n, n) for n coordinates."""
    push: FloatArray
    """G [1/A], shape (n,)."""
    feedback: FloatArray
    """K [A], shape (n,)."""
    law: FloatArray
    whole: FloatArray
    before: FloatArray
    after: FloatArray
    reading: FloatArray
    by_state: FloatArray
    by_reading: FloatArray
    embedded: FloatArray
    moved: FloatArray
