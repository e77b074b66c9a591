# SPDX-License-Identifier: Apache-2.0
"""Offline recordings to files: a rosbag2 folder, and a separate noise-free log."""

from __future__ import annotations

import time
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Annotated

import yaml

from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.settings import quantity
from hydro_bridge.signals import SAMPLE_PERIOD
from hydro_sim.box.box import BoxConfig, Integral
from hydro_sim.emulator.offline import Recording, record_offline, with_gain_limits_for
from hydro_sim.emulator.truth.config import TruthConfig, load_truth, profile
from hydro_sim.excitation.schedules import Segment, load_schedule
from hydro_sim.model.bench import Bench

DEFAULT_SCHEDULE = (
    Segment(seconds=6.0, waveform="multisine", amplitude=280.0, frequency=0.7),
    Segment(seconds=4.0, waveform="sine", amplitude=250.0, frequency=1.5),
    Segment(seconds=4.0, waveform="smooth_step", amplitude=200.0, frequency=0.5),
    Segment(seconds=4.0, waveform="sine", amplitude=150.0, offset=100.0, frequency=0.5),
    Segment(seconds=2.0, waveform="hold", offset=-100.0),
)
"""Default schedule of 20 s, of varied waveforms."""


def fit_to(segments: Sequence[Segment], seconds: float) -> list[Segment]:
    """Repeat or cut the segments so that they last `seconds` in total."""
    result: list[Segment] = []
    left = seconds
    while left > 0.5 * SAMPLE_PERIOD:
        segment = segments[len(result) % len(segments)]
        result.append(replace(segment, seconds=min(segment.seconds, left)))
        left -= segment.seconds
    return result


@dataclass(frozen=True, kw_only=True)
class Job:
    """One offline recording; paths are relative to the working directory."""

    out: str
    truth: str | None = None  # absent: the default profile
    schedule: str | None = None  # absent: 20 s with something of everything
    bench: str | None = None  # what the box believes; absent: the nominal bench
    noise_free: str | None = None  # .npz for scoring; absent: none
    seconds: Annotated[float, quantity("s", 1e-3, 36000.0)] | None = None  # absent: the schedule once
    seed: Annotated[int, quantity("-", 0, 2**62)] = 0
    integral: Integral = "bumpless"  # form of the force law's integral


def run(job: Job) -> Recording:
    """Record `job` into its folder and, if asked for, its noise-free file; prints one line."""
    began = time.perf_counter()
    config = truth(job.truth)
    bench = Bench.load(job.bench) if job.bench else Bench.nominal()
    segments: Sequence[Segment] = load_schedule(job.schedule) if job.schedule else DEFAULT_SCHEDULE
    if job.seconds is not None:
        segments = fit_to(segments, job.seconds)
    box = with_gain_limits_for(segments, BoxConfig(integral=job.integral))
    recording = record_offline(config, segments, bench=bench, box=box, seed=job.seed)
    write_bag(job.out, recording, bench)
    if job.noise_free:
        recording.save_noise_free(job.noise_free)
    print(f"{job.out}: {len(recording.states) * 1e-3:g} s of bench in {time.perf_counter() - began:.2f} s", flush=True)
    return recording


def write_bag(folder: str | Path, recording: Recording, bench: Bench) -> None:
    """Write what the bench recorded as a rosbag2 folder; the truth stays out of it.

    Box time 0 becomes the present second of ROS time.
    """
    states = recording.states.copy()
    states["time"] += float(int(time.time()))
    attachments = {"bench.yaml": yaml.safe_dump(bench.to_mapping(), sort_keys=False).encode()}
    with BagWriter(folder, metadata={"source": "hydro_sim emulator --offline"}, attachments=attachments) as bag:
        bag.write_states(states)


def truth(path: str | None) -> TruthConfig:
    """Load the truth from a YAML file, or return the default profile."""
    return load_truth(path) if path else profile("default")
