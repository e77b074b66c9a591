# SPDX-License-Identifier: Apache-2.0
"""Recordings of the cases by the emulator, offline.

A run that cannot be used is recorded again as an operator would, decided from the run alone: first lower gains and a
smaller reference; if the bench still trips or swings from stop to stop, the box assumes a stronger valve, so that its
force law compensates the velocity term only in part. The diagnosis reads the recorded valve current and is not
concerned.
"""

from __future__ import annotations

import shutil
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.prove.cases import FITTED, HELD, Case, missing
from hydro_bridge.bags.recording import read_bag
from hydro_core.signals import Flag
from hydro_diagnosis import jobs
from hydro_diagnosis.io.table import read_table
from hydro_diagnosis.preprocessing.quality import check_recording
from hydro_diagnosis.recording import UnusableRecordingError
from hydro_sim.box.box import BoxConfig
from hydro_sim.emulator.offline import record_offline, with_gain_limits_for, write_bag
from hydro_sim.emulator.truth.config import truth_from_mapping
from hydro_sim.excitation import parse_schedule
from hydro_sim.model.bench import Bench

USED = 0.5
"""Share of a run that must be free of end stops and cavitation."""
SATURATED = 0.01
"""Share of a run in which the valve current may stand at its limit."""


@dataclass(frozen=True, kw_only=True)
class Attempt:
    """Settings of one attempt at a run."""

    amplitude: float = 1.0
    """Share of the drawn reference's amplitude."""
    kp: float = 1e3
    """Upper limit [1/s] of the drawn K_p."""
    ki: float = 1e3
    """Upper limit [1/s^2] of the drawn K_i."""
    believed_flow: float = 1.0
    """`valve_nominal_flow` that the box assumes, over that of bench.yaml."""


ATTEMPTS = (
    Attempt(),
    Attempt(amplitude=0.6, kp=30.0, ki=5.0),
    Attempt(believed_flow=1.25),
    Attempt(believed_flow=1.6, amplitude=0.6),
    Attempt(believed_flow=2.5, amplitude=0.6),
)
"""Tried in order until a run is usable; the last one is kept in any case."""


def usable(bag: Path) -> bool:
    """Return whether the box did not trip, the valve hardly saturated, and the stops were mostly left alone."""
    flags = read_bag(bag, topics=("/hydro/state",)).state["flags"]
    if (flags & Flag.TRIPPED).any() or np.mean((flags & Flag.SATURATED) > 0) > SATURATED:
        return False
    try:
        recording = check_recording(read_table(bag), Bench.nominal())
    except UnusableRecordingError:
        return False
    return recording.seconds >= USED * 1e-3 * len(flags)


def record(cases: Sequence[Case], folder: Path, **where: Any) -> None:
    """Record the missing runs of `cases` into `folder`/CASE/{run1, run2, run3, held}, side by side."""
    left = {case.name: (case, folder / case.name) for case in cases if missing(folder / case.name)}
    jobs.run_all(_record, left, **where, label="recording", unit="case")


def _record(case: Case, folder: Path) -> None:
    """Record the missing runs of a case; each has another name until it is accepted."""
    for name in missing(folder):
        fresh = folder / f"{name}-fresh"
        for attempt in ATTEMPTS:
            shutil.rmtree(fresh, ignore_errors=True)  # what a Ctrl-C or a trip has left
            _play(case, name, attempt, fresh)
            if usable(fresh):
                break
        fresh.rename(folder / name)


def _play(case: Case, name: str, attempt: Attempt, out: Path) -> None:
    """Record one run on the nominal bench, whatever the box assumes, with the concealed causes."""
    nominal, drawn = Bench.nominal(), case.schedules[name]
    parts = {"bench": nominal.to_mapping(), "sensors": {"noise_scale": case.noise}}
    truth = truth_from_mapping({"profile": "nominal", **parts, "effects": case.effects, "outside": case.outside})
    gains = {"kp": min(attempt.kp, drawn["kp"]), "ki": min(attempt.ki, drawn["ki"])}
    played = {**drawn, "amplitude": attempt.amplitude * drawn["amplitude"], **gains}
    segments = parse_schedule({"segments": [played]}, case.name)
    believed = replace(nominal, valve_nominal_flow=attempt.believed_flow * nominal.valve_nominal_flow)
    box = with_gain_limits_for(segments, BoxConfig().of_bench(believed))
    seed = 10 * case.seed + (*FITTED, HELD).index(name)
    write_bag(out, record_offline(truth, segments, bench=believed, box=box, seed=seed), believed)
