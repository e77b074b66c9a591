# SPDX-License-Identifier: Apache-2.0
"""Offline recordings of the emulated bench, bit-identical to those in real time, in memory and as files."""

from __future__ import annotations

import math
import time
from collections.abc import Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path

import numpy as np
import yaml

from hydro_bridge.bags.recording import BagWriter
from hydro_core.bench_scales import rescale
from hydro_core.settings import from_mapping
from hydro_core.signals import PLANT_FIELDS, SAMPLE_PERIOD, Command, FloatArray, StateArray
from hydro_sim.box import firmware
from hydro_sim.box.box import BoxConfig, fill_command
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.truth.config import TruthBench, TruthConfig, load_truth, truth_from_mapping
from hydro_sim.excitation import Segment
from hydro_sim.model.bench import NOMINAL, Bench


@dataclass(frozen=True, kw_only=True, eq=False)
class Recording:
    """One recorded run; all arrays have n samples."""

    states: StateArray
    """Samples that the bench recorded, `STATE_DTYPE`, shape (n,)."""
    noise_free: StateArray
    """The same run's readings without noise and quantisation, amplifiers' lags included; for scoring only."""
    physical: FloatArray
    """The truth before any sensor, columns `truth.plant.TRUTH_FIELDS`, shape (n, 12); for scoring only."""


def record_offline(
    config: TruthConfig, segments: Sequence[Segment], *, bench: Bench | None = None, box: BoxConfig | None = None,
    seed: int = 0,
) -> Recording:  # fmt: skip
    """Record the emulated bench while it tracks one segment after the other.

    `config`: the truth. `segments`: references and gains, in order; the first sample is still disarmed, and arming then
    fades the first reference in. `bench`: bench that the box's force law assumes; absent: the nominal bench. `box`: its
    settings; absent: the defaults with gain limits wide enough for the segments. `seed`: of noise and random force.
    """
    settings = box or with_gain_limits_for(segments)
    commands = np.zeros(len(segments) + 1, firmware.DOUBLE_STRUCTURES.command)
    fill_command(commands[:1], Command())
    for index, segment in enumerate(segments, 1):
        command = Command(
            arm=True, delta_kp=segment.kp - settings.base_kp, delta_ki=segment.ki - settings.base_ki,
            delta_u=segment.delta_u, reference=segment.signal, filter_fresh=True,
        )  # fmt: skip
        fill_command(commands[index : index + 1], command)
    seconds = [segment.seconds for segment in segments]
    ends = [round(math.fsum(seconds[: k + 1]) / SAMPLE_PERIOD) for k in range(len(seconds))]
    which = np.searchsorted(np.array(ends), np.arange(ends[-1]), side="right") + 1
    which[0] = 0
    states, clean, physical = Machine(config, bench, settings, seed).run(commands, which.astype(np.int64))
    noise_free = states.copy()
    for column, name in enumerate(PLANT_FIELDS):
        noise_free[name] = clean[:, column]
    return Recording(states=states, noise_free=noise_free, physical=physical)


def with_gain_limits_for(segments: Sequence[Segment], base: BoxConfig | None = None) -> BoxConfig:
    """Return `base` (None: the defaults) with gain limits wide enough for the segments."""
    base = base or BoxConfig()
    kp = [segment.kp - base.base_kp for segment in segments]
    ki = [segment.ki - base.base_ki for segment in segments]
    return replace(
        base, delta_kp_min=min(base.delta_kp_min, *kp), delta_kp_max=max(base.delta_kp_max, *kp),
        delta_ki_min=min(base.delta_ki_min, *ki), delta_ki_max=max(base.delta_ki_max, *ki),
    )  # fmt: skip


DEFAULT_SCHEDULE = (
    Segment(seconds=6.0, waveform="multisine", amplitude=280.0, frequency=0.7),
    Segment(seconds=4.0, waveform="sine", amplitude=250.0, frequency=1.5),
    Segment(seconds=4.0, waveform="smooth_step", amplitude=200.0, frequency=0.5),
    Segment(seconds=4.0, waveform="sine", amplitude=150.0, offset=100.0, frequency=0.5),
    Segment(seconds=2.0, waveform="hold", offset=-100.0),
)
"""Default schedule of 20 s, of varied waveforms, for the nominal bench."""


def default_schedule(bench: Bench) -> list[Segment]:
    """Return the default excitation, 20 s, with forces rescaled to a bench of this size."""
    return [rescale(segment, NOMINAL, bench.size) for segment in DEFAULT_SCHEDULE]


def fit_duration(segments: Sequence[Segment], seconds: float) -> list[Segment]:
    """Repeat or cut the segments so that they last `seconds` in total."""
    result: list[Segment] = []
    left = seconds
    while left > 0.5 * SAMPLE_PERIOD:
        segment = segments[len(result) % len(segments)]
        result.append(replace(segment, seconds=min(segment.seconds, left)))
        left -= segment.seconds
    return result


def write_bag(folder: str | Path, recording: Recording, bench: Bench) -> None:
    """Write the recording as a rosbag2 folder, without the truth.

    Box time 0 becomes the present second of ROS time.
    """
    states = recording.states.copy()
    states["time"] += float(int(time.time()))
    attachments = {"bench.yaml": yaml.safe_dump(bench.to_mapping(), sort_keys=False).encode()}
    with BagWriter(folder, metadata={"source": "hydro_sim emulator --offline"}, attachments=attachments) as bag:
        bag.write_states(states)


def load_truth_config(path: str | None, bench: Bench) -> TruthConfig:
    """Load the truth of a YAML file (None: the default profile), with parameters of `bench` where the file has none.

    Raises SettingsError: as `truth_from_mapping`, or a parameter of `bench` is out of the emulator's range.
    """
    numbers = {each.name: getattr(bench, each.name) for each in fields(TruthBench) if hasattr(bench, each.name)}
    own = from_mapping(TruthBench, numbers, "bench")
    return load_truth(path, own) if path else truth_from_mapping({}, bench=own)
