# SPDX-License-Identifier: Apache-2.0
"""Two recordings of a case, as a bench would leave them: a rosbag2 folder, or a table in units of its own."""

from __future__ import annotations

import shutil
from pathlib import Path

import numpy as np

from benchmarks.foreign_truth.bench import numbers
from benchmarks.foreign_truth.box import PERIOD
from benchmarks.foreign_truth.cases import Case
from benchmarks.foreign_truth.plant import SUBSTEPS, FloatArray, run
from hydro_bridge.bags.recording import BagWriter
from hydro_bridge.signals import STATE_DTYPE, STATE_FIELDS, StateArray

SECONDS = 25.0
RUNS = {"sines": 80.0, "steps": 65.0}
"""K_p [1/s] by reference: the first is fitted, the second held out. K_i is 15 in both."""
FORCE_NOISE, PRESSURE_NOISE, QUANTUM = 0.6, 6e3, 1e-6
"""N and Pa (standard deviations), m (step of the encoder), at noise 1."""
EPOCH = 1_760_000_000.0
COLUMNS = (
    "time=t[ms],hydraulic_force=Fh,load_force=Fl[kN],pressure_a=pA[bar],pressure_b=pB[bar],"
    "piston_position=pos[mm]+40,valve_current=i[mA]"
)
"""What `diagnose --columns` is told of a table."""


def reference(kind: str, count: int, seed: int) -> FloatArray:
    """Force and its rate [N, N/s], shape (count, 2): a multisine, or filtered steps under a sine that sweeps."""
    time, random = np.arange(count) * PERIOD, np.random.default_rng(seed)
    if kind == "sines":
        force = 220.0 * np.sin(2.0 * np.pi * 1.3 * time)
        for frequency, amplitude in zip((0.37, 0.71, 2.3, 4.1, 6.7, 9.3), (40, 30, 25, 15, 10, 7), strict=True):
            force += amplitude * np.sin(2.0 * np.pi * frequency * time + random.uniform(0.0, 6.28))
    else:
        levels = np.repeat(random.uniform(-280.0, 280.0, count // 700 + 1), 700)[:count]
        smooth = _lag(_lag(levels, 4.0), 4.0)
        force = 0.8 * smooth + 50.0 * np.sin(2.0 * np.pi * (0.5 * time + 1.75 / time[-1] * time**2))
    force *= 1.0 - np.exp(-((time / 0.3) ** 2))
    return np.column_stack([force, np.gradient(force, PERIOD)])


def _lag(signal: FloatArray, bandwidth: float) -> FloatArray:
    """First-order low-pass, from rest."""
    out, share = np.zeros_like(signal), PERIOD * 2.0 * np.pi * bandwidth
    for k in range(1, len(signal)):
        out[k] = out[k - 1] + share * (signal[k] - out[k - 1])
    return out


def simulated(case: Case, number: int, seconds: float = SECONDS, substeps: int = SUBSTEPS) -> FloatArray:
    """Log of the case's run of this number, shape (n, LOGGED); its seeds follow from the case's name."""
    kind, gain = list(RUNS.items())[number]
    seed, count = 10 * sum(map(ord, case.name)) + number, round(seconds / PERIOD)
    deviations = np.array([FORCE_NOISE, FORCE_NOISE, PRESSURE_NOISE, PRESSURE_NOISE])
    noise = case.noise * deviations * np.random.default_rng([seed, 1]).standard_normal((count, 4))
    out = run(
        numbers(**case.truth), reference(kind, count, seed), box=numbers(**case.box), gains=(gain, 15.0), noise=noise,
        quantum=case.noise * QUANTUM, start=6e6 + 4e5 * number, substeps=substeps,
    )  # fmt: skip
    if case.rows_late:
        out[case.rows_late :, 8] = out[: -case.rows_late, 8].copy()
        out[: case.rows_late, 8] = 0.0
    return out


def recorded(case: Case, folder: Path, seconds: float = SECONDS, substeps: int = SUBSTEPS) -> list[Path]:
    """The case's two recordings in a folder; those that are there already stay."""
    folder.mkdir(parents=True, exist_ok=True)
    paths = []
    for number, kind in enumerate(RUNS):
        path = folder / f"{kind}{'.csv' if case.table else ''}"
        if not path.exists():
            scratch = folder / "unfinished" / path.name
            shutil.rmtree(scratch.parent, ignore_errors=True)
            scratch.parent.mkdir()
            log = simulated(case, number, seconds, substeps)
            _write_table(scratch, log) if case.table else write_bag(scratch, log)
            scratch.rename(path)
            scratch.parent.rmdir()
        paths.append(path)
    return paths


def write_bag(folder: Path, log: FloatArray) -> None:
    """Write a log, shape (n, LOGGED), as a rosbag2 folder that there is not yet."""
    with BagWriter(folder) as bag:
        bag.write_states(states_of(log))


def states_of(log: FloatArray) -> StateArray:
    """A log, shape (n, LOGGED), as a recording holds it."""
    states = np.zeros(len(log), STATE_DTYPE)
    states["sequence"] = np.arange(len(log))
    states["time"] = EPOCH + PERIOD * states["sequence"]
    for column, name in enumerate(STATE_FIELDS):
        states[name] = log[:, column]
    states["flags"] = log[:, len(STATE_FIELDS)]
    return states


def _write_table(path: Path, log: FloatArray) -> None:
    """Comma-separated, in ms, N, kN, bar, mm from mid-stroke, and mA."""
    scale = np.array([1.0, 1e-3, 1e-5, 1e-5, 1e3, 1e3])
    content = np.column_stack([np.arange(len(log)), scale * log[:, [0, 2, 4, 5, 6, 8]] - [0, 0, 0, 0, 40, 0]])
    np.savetxt(path, content, delimiter=",", header="t,Fh,Fl,pA,pB,pos,i", comments="", fmt="%.9g")
