# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_sim emulator`: the emulated bench on a serial line, or recorded offline. docs/emulator.md."""

from __future__ import annotations

import argparse
import sys
import time
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import yaml

from hydro_bridge.recording import BagWriter, RecordingError
from hydro_sim.bench import Bench
from hydro_sim.emulator.offline import Recording, record_offline
from hydro_sim.emulator.schedules import DEFAULT_SCHEDULE, Segment, fit_to, load_schedule
from hydro_sim.emulator.settings import ConfigError, from_mapping, quantity, read_yaml
from hydro_sim.emulator.truth_config import TruthConfig, load_truth, profile, truth_to_mapping


@dataclass(frozen=True, kw_only=True)
class Job:
    """One offline recording; paths are relative to the working directory."""

    out: str
    truth: str | None = None  # absent: the default profile
    schedule: str | None = None  # absent: 20 s with something of everything
    bench: str | None = None  # what the box believes; absent: the nominal bench
    noise_free: str | None = None  # .npz for scoring; absent: none
    seconds: float | None = quantity(None, unit="s", low=1e-3, high=36000.0)  # absent: the schedule once
    seed: int = quantity(0, low=0, high=2**62)


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status: 0, or 2 after one sentence on what cannot be used."""
    options = _parser().parse_args(arguments)
    try:
        return _run(options)
    except (ConfigError, RecordingError, ValueError, OSError) as error:
        print(f"emulator: {error}", file=sys.stderr)
        return 2


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="emulator", description=__doc__, allow_abbrev=False)
    parser.add_argument("--truth", metavar="FILE", help="what the bench is made of (default: the default profile)")
    parser.add_argument("--bench", metavar="FILE", help="what the box believes (default: the nominal bench)")
    parser.add_argument("--seconds", type=float, metavar="S", help="how long (default: until stopped; offline: the schedule)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of noise, random forces and link faults")
    parser.add_argument("--noise-free", metavar="FILE.npz", help="also write the run without noise, for scoring only")
    parser.add_argument("--print-truth", action="store_true", help="print the whole truth as YAML and stop")
    offline = parser.add_argument_group("offline: record as fast as the machine computes, the same samples to the bit")
    offline.add_argument("--offline", action="store_true")
    offline.add_argument("--out", metavar="BAG", help="folder of the recording, made here")
    offline.add_argument("--schedule", metavar="FILE", help="references and gains")
    offline.add_argument("--batch", metavar="FILE", help="many recordings: a list of jobs with the options above as keys")
    return parser


def _run(options: argparse.Namespace) -> int:
    if options.print_truth:
        print(yaml.safe_dump(truth_to_mapping(_truth(options.truth)), sort_keys=False), end="")
        return 0
    if options.offline or options.batch:
        for job in _jobs(options):
            run_job(job)
        return 0
    raise ConfigError("the serial line comes next; use --offline")


def _jobs(options: argparse.Namespace) -> list[Job]:
    if options.batch:
        entries = read_yaml(options.batch).get("jobs")
        if not isinstance(entries, list):
            raise ConfigError(f"{options.batch} must hold a list under the key jobs")
        return [from_mapping(Job, entry, f"jobs[{index}]") for index, entry in enumerate(entries)]
    if not options.out:
        raise ConfigError("--offline needs --out, the folder of the recording")
    keys = ("out", "truth", "schedule", "bench", "noise_free", "seconds", "seed")
    return [from_mapping(Job, {key: getattr(options, key) for key in keys}, "emulator")]


def run_job(job: Job) -> Recording:
    """Record `job` into its folder and, if asked for, its noise-free file; prints one line."""
    began = time.perf_counter()
    config = _truth(job.truth)
    bench = Bench.load(job.bench) if job.bench else Bench.nominal()
    segments: Sequence[Segment] = load_schedule(job.schedule) if job.schedule else DEFAULT_SCHEDULE
    if job.seconds is not None:
        segments = fit_to(segments, job.seconds)
    recording = record_offline(config, segments, bench=bench, seed=job.seed)
    write_bag(job.out, recording, bench)
    if job.noise_free:
        recording.save_noise_free(job.noise_free)
    seconds, wall = len(recording.states) * 1e-3, time.perf_counter() - began
    print(f"{job.out}: {seconds:g} s of bench in {wall:.2f} s")
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


def _truth(path: str | None) -> TruthConfig:
    return load_truth(path) if path else profile("default")


def main_and_exit() -> Any:
    """For `python -m`."""
    raise SystemExit(main())


if __name__ == "__main__":
    main_and_exit()
