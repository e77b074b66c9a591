# SPDX-License-Identifier: Apache-2.0
"""Offline recordings of the emulated bench, bit-identical to those in real time."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import numpy.typing as npt

from hydro_bridge.signals import PLANT_FIELDS, SAMPLE_PERIOD, Command, FloatArray, StateArray
from hydro_sim.box import kernel
from hydro_sim.box.box import BoxConfig, fill_command
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth.config import TruthConfig
from hydro_sim.emulator.truth.plant import TRUTH_FIELDS
from hydro_sim.excitation.schedules import Segment
from hydro_sim.model.bench import Bench


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """One recorded run; all arrays have n samples."""

    states: StateArray
    """Samples that the bench recorded, `STATE_DTYPE`, shape (n,)."""
    noise_free: StateArray
    """The same run's readings without noise and quantisation, amplifiers' lags included; for scoring only."""
    physical: FloatArray
    """The truth before any sensor, columns `TRUTH_FIELDS`, shape (n, 12); for scoring only."""

    def save_noise_free(self, path: str | Path) -> None:
        """Write `noise_free` and `physical` (with `physical_fields`) to an .npz file; a missing folder is made."""
        Path(path).parent.mkdir(parents=True, exist_ok=True)
        np.savez_compressed(
            path, noise_free=self.noise_free, physical=self.physical, physical_fields=np.array(TRUTH_FIELDS)
        )


def record_offline(
    config: TruthConfig,
    segments: Sequence[Segment],
    *,
    bench: Bench | None = None,
    box: BoxConfig | None = None,
    seed: int = 0,
) -> Recording:
    """Record the emulated bench while it tracks one segment after the other.

    Parameters
    ----------
    config
        The truth.
    segments
        References and gains, in order. The first sample is still disarmed; arming then fades the first reference in.
    bench
        What the box's force law believes; absent: the nominal bench.
    box
        Settings of the box; absent: the defaults with gain limits wide enough for the segments.
    seed
        Of noise and random force.
    """
    settings = box or with_gain_limits_for(segments)
    machine = Machine(config, bench, settings, seed)
    commands, which = _schedule(segments, settings)
    states, clean, physical = machine.run(commands, which)
    return Recording(states=states, noise_free=noise_free_states(states, clean), physical=physical)


def noise_free_states(states: StateArray, clean: FloatArray) -> StateArray:
    """Copy of `states`, shape (n,), with the measured fields replaced by `clean`, shape (n, 8)."""
    result = states.copy()
    for column, name in enumerate(PLANT_FIELDS):
        result[name] = clean[:, column]
    return result


def with_gain_limits_for(segments: Sequence[Segment], base: BoxConfig | None = None) -> BoxConfig:
    """`base` (absent: the defaults) with gain limits wide enough for the segments."""
    base = base or BoxConfig()
    kp = [segment.kp - base.base_kp for segment in segments]
    ki = [segment.ki - base.base_ki for segment in segments]
    return replace(
        base,
        delta_kp_min=min(base.delta_kp_min, *kp),
        delta_kp_max=max(base.delta_kp_max, *kp),
        delta_ki_min=min(base.delta_ki_min, *ki),
        delta_ki_max=max(base.delta_ki_max, *ki),
    )


def _schedule(segments: Sequence[Segment], settings: BoxConfig) -> tuple[npt.NDArray[np.void], npt.NDArray[np.int64]]:
    """Commands, shape (m + 1,), the first disarms; and which of them comes before each sample, shape (n,)."""
    commands = np.zeros(len(segments) + 1, kernel.COMMAND_DTYPE)
    fill_command(commands[:1], Command())
    for index, segment in enumerate(segments):
        command = Command(
            arm=True,
            delta_kp=segment.kp - settings.base_kp,
            delta_ki=segment.ki - settings.base_ki,
            delta_u=segment.delta_u,
            reference=segment.signal,
            filter_fresh=True,
        )
        fill_command(commands[index + 1 : index + 2], command)
    ends = [
        round(math.fsum(segment.seconds for segment in segments[: k + 1]) / SAMPLE_PERIOD) for k in range(len(segments))
    ]
    which = np.searchsorted(np.array(ends), np.arange(ends[-1]), side="right") + 1
    which[0] = 0
    return commands, which.astype(np.int64)
