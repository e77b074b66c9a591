# SPDX-License-Identifier: Apache-2.0
"""Rewards [-]: tracking reward over an action's samples (eq. reward), and penalty of a trip."""

from __future__ import annotations

import numpy as np

from hydro_core.signals import FloatArray
from hydro_policy.task.mdp.settings import TaskSettings


def tracking(task: TaskSettings, error: FloatArray, error_rate: FloatArray) -> FloatArray:
    """Return the tracking reward (eq. reward at power 2) from means of e [N], e' [N/s] over samples, (..., n) to (...).

    The paper evaluates it at one instant, where the derivative's noise alone contributes -20 per step. In the mean over
    ten samples, which is the change of e over the step, it contributes -2; the weight of tracking is the same.
    """
    e, de = np.mean(error, axis=-1) / task.force_scale, np.mean(error_rate, axis=-1) / task.force_rate_scale
    return np.asarray(-((task.error_weight * e * e + task.error_rate_weight * de * de) ** (0.5 * task.reward_power)))


def trip(task: TaskSettings) -> float:
    """Return the reward of an action under which the box trips."""
    return -task.trip_penalty
