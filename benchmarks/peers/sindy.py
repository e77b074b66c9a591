# SPDX-License-Identifier: Apache-2.0
"""PySINDy on the terms of `terms`: what it keeps, and the corrected model."""

from __future__ import annotations

import json
import subprocess
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.peers import terms
from benchmarks.peers.run import DYNAMIC, READ, Corrected, Recordings, Signals, held_out, signals
from benchmarks.peers.terms import readings
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model.bench import Bench

Equations = dict[str, dict[str, FloatArray]]
WORKER = Path(__file__).with_name("sindy_worker.py")


def solve(case: Recordings, python: Path) -> tuple[dict[str, list[str]], float]:
    """Terms kept by equation, and the held-out error over the noise floor."""
    bench = Bench.nominal()
    with tempfile.TemporaryDirectory() as scratch:
        source, target = Path(scratch) / "in.npz", Path(scratch) / "out.json"
        names = _write(case, bench, source)
        subprocess.run([python, WORKER, source, target], check=True, capture_output=True)
        found = json.loads(target.read_text())
    kept = {
        equation: {name: value for name, value in zip(names[equation], one["coefficients"], strict=True) if value}
        for equation, one in found.items()
    }
    plants = [Corrected.by(model, _correction(kept, model, bench)) for model in case.held]
    return {equation: list(terms) for equation, terms in kept.items()}, held_out(plants, case.noise)


def _write(case: Recordings, bench: Bench, path: Path) -> dict[str, list[str]]:
    """Write what the worker regresses; returns the terms' names by equation."""
    arrays: dict[str, Any] = {"runs": len(case.fitted), "equations": json.dumps([*DYNAMIC, *READ])}
    names: dict[str, list[str]] = {}
    pressure = case.noise["pressure_a"]
    by_pressures = bench.piston_area * pressure * np.hypot(1.0, bench.area_ratio)
    in_rate = case.noise["hydraulic_force"] / bench.moving_mass
    in_force = float(np.hypot(case.noise["hydraulic_force"], by_pressures))
    noise = {"velocity": (0.0, in_rate), "pressure_a": (pressure, 0.0), "pressure_b": (case.noise["pressure_b"], 0.0),
             "load_force": (case.noise["load_force"], 0.0),
             "hydraulic_force": (in_force, 0.0)}  # fmt: skip
    for run, model in enumerate(case.fitted):
        keep = slice(model.settle, len(model.time) - model.settle)
        shown = readings(model, bench)
        columns = candidates(signals(model), shown["load_force"], shown["hydraulic_force"], bench, model.step)
        arrays[f"time/{run}"] = model.time[keep] - model.time[keep][0]
        for equation, (state, nominal) in targets(model, bench).items():
            names[equation] = list(columns[equation])
            arrays[f"{equation}/read"] = equation in READ
            arrays[f"{equation}/state/{run}"], arrays[f"{equation}/nominal/{run}"] = state[keep], nominal[keep]
            arrays[f"{equation}/terms/{run}"] = np.column_stack([one[keep] for one in columns[equation].values()])
            arrays[f"{equation}/noise/{run}"] = noise[equation]
    np.savez(path, **arrays)
    return names


def _correction(kept: dict[str, dict[str, float]], model: Any, bench: Bench) -> Any:
    """What the terms kept add to rates, and along the recording to readings."""
    shown = readings(model, bench)
    along = candidates(signals(model), shown["load_force"], shown["hydraulic_force"], bench, model.step)

    def correct(signal: Signals) -> dict[str, FloatArray]:
        here = dynamic_candidates(signal, bench)
        added = {name: _sum(kept[name], here[name]) for name in DYNAMIC}
        return {**added, **{name: _sum(kept[name], along[name]) for name in READ}}

    return correct


def _sum(coefficients: dict[str, float], terms: dict[str, FloatArray]) -> FloatArray:
    total = np.zeros_like(next(iter(terms.values())))
    for name, value in coefficients.items():
        total = total + value * terms[name]
    return total


def targets(model: SegmentModel, bench: Bench) -> dict[str, tuple[FloatArray, FloatArray]]:
    """By equation: what is recorded (a state, or a reading), and the nominal rate, or the nominal reading."""
    along = signals(model)
    rates, shown = terms.nominal(along, bench), terms.readings(model, bench)
    dynamic = {name: (along[name], rate) for name, rate in rates.items()}
    return {**dynamic, **{name: (model.channels[name], value) for name, value in shown.items()}}


def candidates(signal: Signals, spring: FloatArray, force: FloatArray, bench: Bench, step: float) -> Equations:
    """Candidate terms by equation; `spring`, `force`: the nominal readings of the two load cells [N]."""
    return {**dynamic_candidates(signal, bench), "load_force": terms.load_terms(spring, bench, step),
            "hydraulic_force": terms.hydraulic_terms(force, signal, step)}  # fmt: skip


def dynamic_candidates(signal: Signals, bench: Bench) -> Equations:
    """Candidate terms of the three equations that are integrated."""
    return {
        "velocity": terms.motion_terms(signal, bench),
        "pressure_a": terms.pressure_terms(signal, bench, "a"),
        "pressure_b": terms.pressure_terms(signal, bench, "b"),
    }
