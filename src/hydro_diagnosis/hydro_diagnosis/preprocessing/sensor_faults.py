# SPDX-License-Identifier: Apache-2.0
"""Detection of frozen sensors: a noisy one repeats its number, an encoder does so while the piston moves.

An encoder is quantised and a piston may stand: equal positions alone say nothing. Frozen is one that stays exactly
where it is while the load's force or the reported velocity moves on, or that jumps when it comes back. What follows a
stop for a moment (the load cell's amplifier rings, the velocity's filter runs out) does not count.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.preprocessing.white_noise import white_noise
from hydro_sim.model.bench import Bench

FROZEN = 40
"""Samples: a noisy sensor that repeats the same number so often has stopped, an encoder may have."""
DISPLACED = 2e-4
"""m by which the piston must move, by what else there is, while its encoder stands."""
QUANTA = 10.0
"""Steps of the encoder that it must move at least."""
LOAD_SETTLES, VELOCITY_SETTLES = 0.1, 0.03
"""s after a stop until load cell and velocity show it too."""
AVERAGED = 20
"""Samples over which the load's force is averaged."""
NOISE = 8.0
"""Standard deviations of such a mean that its range must exceed."""
MOVES = 0.2
"""Share of the recording's mean speed that the reported one must have: an offset of a tachometer is no motion."""
Mask = npt.NDArray[np.bool_]


def repeats(values: FloatArray) -> Mask:
    """Samples within a run of at least `FROZEN` equal values."""
    mask = np.zeros(len(values), dtype=bool)
    for begin, end in _runs(values):
        mask[begin:end] = True
    return mask


def frozen_encoder(columns: Mapping[str, FloatArray], step: float, bench: Bench) -> Mask:
    """Samples in which `piston_position` stands though the piston moves; `step` is the sampling time in s."""
    position = columns["piston_position"]
    steps = np.abs(np.diff(position))
    quantum = float(np.min(steps[steps > 0.0], initial=np.inf))
    least = max(DISPLACED, QUANTA * quantum) if np.isfinite(quantum) else DISPLACED
    mask = np.zeros(len(position), dtype=bool)
    for begin, end in _runs(position):
        jumps = end < len(position) and abs(position[end] - position[end - 1]) > least
        if jumps or _load_moves(columns, begin, end, step, bench, least) or _glides(columns, begin, end, step, least):
            mask[begin:end] = True
    return mask


def _runs(values: FloatArray) -> list[tuple[int, int]]:
    """First and one past the last sample of every run of at least `FROZEN` equal values."""
    same = np.concatenate([[False], np.diff(values) == 0.0, [False]])
    edges = np.flatnonzero(np.diff(same.astype(np.int8)))
    return [(b, e + 1) for b, e in zip(edges[::2], edges[1::2], strict=True) if e - b >= FROZEN]


def _load_moves(
    columns: Mapping[str, FloatArray], begin: int, end: int, step: float, bench: Bench, least: float
) -> bool:
    """Return whether the load's force changes by what the spring does over `least` [m], and beyond the noise."""
    if "load_force" not in columns:
        return False
    settled = columns["load_force"][begin + round(LOAD_SETTLES / step) : end]
    means = settled[: len(settled) // AVERAGED * AVERAGED].reshape(-1, AVERAGED).mean(axis=1)
    means = means[np.isfinite(means)]
    if len(means) < 2:
        return False
    noise = white_noise(columns["load_force"][np.isfinite(columns["load_force"])])
    return float(np.ptp(means)) > max(bench.spring_stiffness * least, NOISE * noise / AVERAGED**0.5)


def _glides(columns: Mapping[str, FloatArray], begin: int, end: int, step: float, least: float) -> bool:
    """Return whether the reported velocity carries the piston by more than `least` [m]."""
    if "piston_velocity" not in columns:
        return False
    speed = np.abs(columns["piston_velocity"])
    settled = speed[begin + round(VELOCITY_SETTLES / step) : end]
    settled = settled[np.isfinite(settled)]
    if not len(settled):
        return False
    return bool(settled.sum() * step > least and settled.mean() > MOVES * np.nanmean(speed))
