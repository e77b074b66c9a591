# SPDX-License-Identifier: Apache-2.0
"""The task as a Markov decision process, for trainer, pretraining and the Gymnasium environment.

observations   13 components (eq. obs)
actions        2 components in [-1, 1], mapped linearly to [delta_kp, delta_ki] (eq. policy_action)
rewards        eq. reward over the action's samples, penalty of a trip
terminations   trips
events         randomisation of an episode: reference, bench and noise
steps          10 box samples of 1 ms; an episode is 1800 steps, 18 s
settings       of all of these
"""

from hydro_policy.task.mdp.actions import ACTION_SIZE, BASE_GAINS, GainRange
from hydro_policy.task.mdp.observations import (
    LOAD_FORCE,
    LOAD_FORCE_RATE,
    OBSERVATION_NAMES,
    OBSERVATION_SIZE,
    REFERENCE,
    REFERENCE_RATE,
    normalization,
    observe,
)
from hydro_policy.task.mdp.settings import TaskSettings
from hydro_policy.task.mdp.steps import Step, StepClock, hold_flags

__all__ = [
    "ACTION_SIZE", "BASE_GAINS", "GainRange", "LOAD_FORCE", "LOAD_FORCE_RATE", "OBSERVATION_NAMES", "OBSERVATION_SIZE",
    "REFERENCE", "REFERENCE_RATE", "normalization", "observe", "TaskSettings", "Step", "StepClock", "hold_flags",
]  # fmt: skip
