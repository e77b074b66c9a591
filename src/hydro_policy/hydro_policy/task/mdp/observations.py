# SPDX-License-Identifier: Apache-2.0
"""Observations (eq. obs): 13 components (value - center) / scale, both proportional to the bench's size."""

from __future__ import annotations

from functools import lru_cache

import numpy as np

from hydro_core.bench_scales import BenchScales
from hydro_core.signals import PLANT_FIELDS, STATE_FIELDS, FloatArray

# Name; scale of `BenchScales`; center and reach of normal runs.
_NORMALIZATION: tuple[tuple[str, str, float, float], ...] = (
    ("hydraulic_force", "force", 0.0, 1.0),
    ("hydraulic_force_rate", "force", 0.0, 3770.0 / 300.0),  # 1/s: the usual amplitude at 2 Hz
    ("load_force", "force", 0.0, 1.0),
    ("load_force_rate", "force", 0.0, 3770.0 / 300.0),
    ("pressure_a", "pressure", 0.53125, 0.34375),  # 3 to 14 MPa of 16
    ("pressure_b", "pressure", 0.53125, 0.34375),
    ("piston_position", "length", 0.5, 0.1875),  # the usual amplitude on the spring about mid-stroke
    ("piston_velocity", "length", 0.0, 2.375),  # 1/s: that at 2 Hz
    ("reference_force", "force", 0.0, 1.0),
    ("reference_force_rate", "force", 0.0, 3770.0 / 300.0),
    ("error", "force", 0.0, 0.1),  # an order below the reference, or the policy would hardly see it
    ("previous_action_kp", "", 0.0, 1.0),
    ("previous_action_ki", "", 0.0, 1.0),
)
OBSERVATION_NAMES = tuple(name for name, *_ in _NORMALIZATION)
OBSERVATION_SIZE = len(OBSERVATION_NAMES)

LOAD_FORCE, LOAD_FORCE_RATE = STATE_FIELDS.index("load_force"), STATE_FIELDS.index("load_force_rate")
REFERENCE, REFERENCE_RATE = STATE_FIELDS.index("reference_force"), STATE_FIELDS.index("reference_force_rate")
_PLANT_SIZE = len(PLANT_FIELDS)


@lru_cache
def normalization(size: BenchScales) -> tuple[FloatArray, FloatArray]:
    """Return center and scale of the observations on a bench of this size, shape (13,) each."""
    scales = vars(size) | {"": 1.0}
    center = np.array([scales[scale] * share for _, scale, share, _ in _NORMALIZATION])
    return center, np.array([scales[scale] * share for _, scale, _, share in _NORMALIZATION])


def observe(sample: FloatArray, previous_action: FloatArray, size: BenchScales) -> FloatArray:
    """Return the normalized observation (eq. obs) o = [x, f_r, f_r', e, previous action], shape (..., 13).

    `sample`: in the order of `STATE_FIELDS`, shape (..., 14), SI units. `previous_action`: shape (..., 2), within
    [-1, 1]. `size`: size of the bench.
    """
    center, scale = normalization(size)
    observation = np.empty((*sample.shape[:-1], OBSERVATION_SIZE))
    observation[..., :_PLANT_SIZE] = sample[..., :_PLANT_SIZE]
    observation[..., _PLANT_SIZE] = sample[..., REFERENCE]
    observation[..., _PLANT_SIZE + 1] = sample[..., REFERENCE_RATE]
    observation[..., _PLANT_SIZE + 2] = sample[..., REFERENCE] - sample[..., LOAD_FORCE]
    observation[..., _PLANT_SIZE + 3 :] = previous_action
    observation -= center
    observation /= scale
    return observation
