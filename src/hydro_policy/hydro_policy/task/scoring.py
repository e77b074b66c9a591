# SPDX-License-Identifier: Apache-2.0
"""Scores of evaluation runs."""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np

from hydro_bridge.signals import SAMPLE_PERIOD, FloatArray, StateArray
from hydro_policy.task.step_aggregator import HELD


@dataclass(frozen=True, kw_only=True)
class Score:
    """Score of one run."""

    controller: str
    case: str
    """Name of the reference."""
    frequency: float
    """Frequency of the reference [Hz] (of a multisine: its slowest sine)."""
    repeat: int
    rmse: float = math.nan
    """Force RMSE [N]; NaN if the run was stopped."""
    true_rmse: float = math.nan
    """N, the same of the force on the specimen, in front of the load cell; NaN unless the plant is emulated."""
    peak: float = math.nan
    """N, largest |e|."""
    chatter: float = math.nan
    """A/s, RMS of u'."""
    proportional_gain: float = math.nan
    """1/s, mean that the box applied."""
    integral_gain: float = math.nan
    """1/s^2, mean that the box applied."""
    lost: int = 0
    """Samples that never arrived."""
    held: int = 0
    """Samples for which the box held base gains (stale correction or command)."""
    stopped: str = ""
    """Why the run was not completed: the box tripped, or the monitor stopped it; empty if it was."""

    @property
    def tripped(self) -> bool:
        """Whether it was stopped."""
        return bool(self.stopped)


@dataclass
class Trace:
    """The measured part of one run; time from 0."""

    controller: str
    case: str
    frequency: float
    states: StateArray  # shape (n,)


def score(trace: Trace, repeat: int, felt: FloatArray | None = None) -> Score:
    """Compute the score of a completed run; `felt` is the force on the specimen [N], shape (n,), if it is known."""
    states = trace.states
    error = states["reference_force"] - states["load_force"]
    steps = np.diff(states["sequence"].astype(np.int64))
    current_rate = np.diff(states["valve_current"]) / (steps * SAMPLE_PERIOD)
    return Score(
        controller=trace.controller,
        case=trace.case,
        frequency=trace.frequency,
        repeat=repeat,
        rmse=float(np.sqrt(np.mean(error**2))),
        true_rmse=math.nan if felt is None else float(np.sqrt(np.mean((states["reference_force"] - felt) ** 2))),
        peak=float(np.abs(error).max()),
        chatter=float(np.sqrt(np.mean(current_rate**2))),
        proportional_gain=float(states["proportional_gain"].mean()),
        integral_gain=float(states["integral_gain"].mean()),
        lost=int((steps - 1).sum()),
        held=int(np.count_nonzero(states["flags"] & HELD)),
    )
