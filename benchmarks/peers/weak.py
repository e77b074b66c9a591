# SPDX-License-Identifier: Apache-2.0
"""What the equations leave unexplained along a recording: states, nominal rates and readings, candidate terms."""

from __future__ import annotations

from benchmarks.peers import terms
from benchmarks.peers.run import Signals, signals
from hydro_diagnosis.effects.base import FloatArray
from hydro_diagnosis.model.segment_model import SegmentModel
from hydro_sim.model.bench import Bench

Equations = dict[str, dict[str, FloatArray]]


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
