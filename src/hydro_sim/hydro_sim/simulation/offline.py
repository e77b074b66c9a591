# SPDX-License-Identifier: Apache-2.0
"""Offline simulation of box and plant, as fast as possible and bit-identical to the nodes.

::

    k:   receive(command_k)   tick(x_k) -> u_k, BenchState_k   plant holds u_k -> x_{k+1}

Box and bench model run in one compiled loop; another `Plant` runs with the same box sample by sample.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np
import numpy.typing as npt

from hydro_bridge.serial.protocol import PAPER_LAW
from hydro_core import signals as core
from hydro_core.signals import SAMPLE_PERIOD, STATE_DTYPE, Command, FloatArray, Law, ReferenceSignal, StateArray
from hydro_sim.box import firmware
from hydro_sim.box.box import Box, BoxConfig, fill_command
from hydro_sim.jit import njit
from hydro_sim.model import plant as plants
from hydro_sim.model.bench import Bench
from hydro_sim.model.plant import AnalyticPlant, Plant


@dataclass(frozen=True, kw_only=True)
class Schedule:
    """Schedule of a run: reference, gains, correction and force law."""

    reference: ReferenceSignal | FloatArray
    """Signal that the box generates, or recorded f_r [N] and f_r' [N/s] of each sample, shape (samples, 2)."""
    gains: FloatArray | tuple[float, float]
    """K_p [1/s] and K_i [1/s^2] in force: one pair, or shape (policy steps, 2) at 100 Hz, the last pair held on."""
    seconds: float
    """Length [s] of the run."""
    correction: FloatArray | None = None
    """delta_u [A] per sample, shape (samples,); None: none, and flagged FILTER_STALE as on the bench."""
    law: Law = Law.PAPER
    """Force law; the compensated one with its safe C_1, C_2 and coefficients."""

    @property
    def samples(self) -> int:
        """Box samples of the run."""
        return round(self.seconds / SAMPLE_PERIOD)


def simulate(
    plant: Plant, bench: Bench, schedule: Schedule, *, config: BoxConfig | None = None, seed: int = 0
) -> StateArray:
    """Simulate one armed run from rest.

    Parameters
    ----------
    plant
        Reset with `seed`, then stepped.
    bench
        Bench that the box's force law assumes; the plant may differ from it.
    schedule
        Reference, gains and correction.
    config
        Settings of the box.
    seed
        Seed of the plant's noise.

    Returns
    -------
    Records of `STATE_DTYPE`, shape (schedule.samples,), time from 0.

    Raises ValueError: the schedule has a recorded reference, and the plant is not analytic.
    """
    box, samples = Box(bench, config), schedule.samples
    changes = _changes(schedule, box.config)
    box.receive(Command(), 0.0)
    measurement = plant.reset(seed)
    law = box.config.compensated if schedule.law is Law.COMPENSATED else PAPER_LAW
    reference, played = ReferenceSignal(), _played(np.zeros((0, 2)), 0)
    if isinstance(schedule.reference, ReferenceSignal):
        reference = schedule.reference
    else:
        played = _played(schedule.reference, samples)
    begin = Command(
        arm=True, reference=reference, filter_fresh=schedule.correction is not None, law=schedule.law,
        velocity_compensation=law.velocity_compensation, valve_gain_scale=law.valve_gain_scale,
    )  # fmt: skip
    output = np.zeros(samples, STATE_DTYPE)
    if isinstance(plant, AnalyticPlant):
        command, playing = np.zeros(1, firmware.DOUBLE_STRUCTURES.command), box.state["reference"]
        fill_command(command, begin)
        records = plant.constants, plant.sensors, plant.state, box.settings, box.state, command
        signals = played, command["reference"], playing["coming"], playing["fade_start"]
        _loop(firmware.function_addresses(), *records, *signals, changes, plant.noise.rows(samples), output)
    elif not len(played):
        for k, (delta_kp, delta_ki, delta_u) in enumerate(changes.tolist()):
            now = k * SAMPLE_PERIOD
            box.receive(replace(begin, delta_kp=delta_kp, delta_ki=delta_ki, delta_u=delta_u), now)
            output[k] = box.tick(measurement, now)
            measurement = plant.step(float(output["valve_current"][k]))
    else:
        raise ValueError("a recorded reference is played on an analytic plant alone")
    return output


@njit
def _loop(
    code, constants, sensors, plant_state, settings, box, command, played, wanted, coming, fade_start, changes, noise,
    output,
):  # fmt: skip
    for k in range(len(output)):
        if len(played) > 0:
            wanted[0] = played[k]
            coming[0] = played[k]
            fade_start[0] = -1.0
        command[0].delta_kp, command[0].delta_ki, command[0].delta_u = changes[k, 0], changes[k, 1], changes[k, 2]
        firmware.receive(code.receive, box, settings, command, k * SAMPLE_PERIOD)
        firmware.tick(code.tick, box, settings, plant_state[0].x, k * SAMPLE_PERIOD, output[k : k + 1])
        plants.advance(constants, sensors, plant_state, noise[k], output[k].valve_current)


PLAYBACK_FREQUENCY = 10.0
"""Hz of the sines that play a recorded reference: their amplitude at 1e5 N/s is within a load cell's range."""


def _played(reference: FloatArray, samples: int) -> npt.NDArray[np.void]:
    """A signal per sample: a sine where it crosses its offset, so that its value and rate are those recorded there.

    None is faded in: a recording holds its own fade. Higher derivatives, which only a_1, a_2 and a_4 of a
    compensated reference would feel, are not the recorded ones. Where f_c is played, the integral is of f_c - f.
    """
    value, rate = reference.T
    signals = np.zeros(samples, firmware.DOUBLE_STRUCTURES.signal)
    signals["waveform"], signals["frequency"] = core.Waveform.SINE, PLAYBACK_FREQUENCY
    signals["amplitude"], signals["offset"] = np.abs(rate) / (2.0 * np.pi * PLAYBACK_FREQUENCY), value
    signals["phase"] = np.where(rate < 0.0, np.pi, 0.0)
    signals["start"] = SAMPLE_PERIOD * np.arange(samples)
    return signals


def _changes(schedule: Schedule, config: BoxConfig) -> FloatArray:
    """Gain changes against the box's base gains, and the correction, shape (samples, 3)."""
    gains, samples = np.atleast_2d(np.asarray(schedule.gains, np.float64)), schedule.samples
    correction = np.zeros(samples) if schedule.correction is None else np.asarray(schedule.correction, np.float64)
    own = config.compensated if schedule.law is Law.COMPENSATED else config
    rows = np.minimum(np.arange(samples) // core.SAMPLES_PER_STEP, len(gains) - 1)
    return np.column_stack(((gains - (own.base_kp, own.base_ki))[rows], correction))
