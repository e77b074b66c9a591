# SPDX-License-Identifier: Apache-2.0
"""Baseline: the assumed bench, as a `Bench` whose `effects` are known and are not claimed again.

It comes from a bench.yaml, from a diagnosis' corrected.yaml, or from the learned weights of `ros2 run hydro_sim learn`:
then the constants that were learned are the bench's numbers, and spool, leak, friction, bristles and amplifier its
effects. Relative to a model learned on a healthy bench a diagnosis names what has worn since.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import dataclass, fields, replace
from math import pi, sqrt
from pathlib import Path
from typing import Any

from hydro_diagnosis.partial_bench import completed, read_bench
from hydro_diagnosis.recording import InputError
from hydro_sim.files.weights import WeightsError
from hydro_sim.learned.model import Learned
from hydro_sim.model.bench import Bench
from hydro_sim.structured.model import StructuredModel

NUMBERS = (
    "bulk_modulus", "piston_area", "area_ratio", "dead_volume_a", "dead_volume_b", "supply_pressure", "tank_pressure",
    "moving_mass", "viscous_friction", "spring_stiffness", "spring_rest_position", "stroke",
)  # fmt: skip
"""Learned constants that are numbers of a bench."""
GAINS = ("valve_gain_a_positive", "valve_gain_a_negative", "valve_gain_b_positive", "valve_gain_b_negative")
GAIN_ALIKE = 0.002
"""Share by which the four learned gains may differ from their mean without a note."""


@dataclass(frozen=True)
class Baseline:
    """The assumed bench, its origin, and the parts of it that the diagnosis cannot represent."""

    bench: Bench
    model: str
    """`analytic`, or `learned` and the file's name."""
    notes: tuple[str, ...] = ()


def baseline(
    bench: Bench | Mapping[str, Any] | str | Path | None,
    model: str | Path | None = None,
    estimated: Collection[str] = (),
) -> Baseline:
    """The baseline of a bench, of a bench's file or its content (None: the nominal one), or of learned weights.

    Of a bench whose file lacks numbers it is a `PartialBench`; `estimated`: those that will be estimated.

    Raises
    ------
    InputError
        If a file cannot be read, if both are given, or if the weights hold no equations.
    """
    if model is not None:
        if bench is not None:
            raise InputError("give a bench file or learned weights as baseline, not both: weights hold a bench")
        return _learned(Path(model))
    try:
        return Baseline(bench if isinstance(bench, Bench) else _read(bench, frozenset(estimated)), "analytic")
    except ValueError as error:
        raise InputError(str(error)) from None


def _read(bench: Mapping[str, Any] | str | Path | None, estimated: frozenset[str]) -> Bench:
    if bench is None:
        return Bench.nominal()
    return completed(bench, estimated) if isinstance(bench, Mapping) else read_bench(bench, estimated)


def _learned(path: Path) -> Baseline:
    try:
        learned = Learned.load(path).model
    except WeightsError as error:
        raise InputError(str(error)) from None
    constants = {entry["name"]: float(entry["value"]) for entry in learned.header()["constants"]}
    return Baseline(bench_of(constants, learned.bench), f"learned {path.name}", tuple(_left_out(constants, learned)))


def bench_of(constants: Mapping[str, float], start: Bench) -> Bench:
    """Learned constants as a bench with effects; `start` gives what is not learned."""
    limits = {entry.name: entry.metadata for entry in fields(start)}
    values = {name: min(max(constants[name], limits[name]["low"]), limits[name]["high"]) for name in NUMBERS}
    gain = sum(constants[name] for name in GAINS) / len(GAINS)
    flow = gain * start.valve_nominal_current * sqrt(start.valve_nominal_pressure_drop / 2.0)
    return replace(
        start, **values, valve_nominal_flow=flow, load_cell_bandwidth=None, effects=tuple(_effects(constants))
    )


def _effects(c: Mapping[str, float]) -> list[dict[str, Any]]:
    """Effects of the learned model beyond a bench's numbers, as entries of a corrected.yaml."""
    entries = [
        _entry("valve_lag", bandwidth=c["spool_frequency"] / (2.0 * pi), damping=c["spool_damping"]),
        _entry("friction_coulomb", force=c["friction_coulomb"]),
        _entry("friction_stribeck", breakaway_force=c["friction_stribeck"], velocity=c["stribeck_velocity"]),
        _entry("friction_presliding", stiffness=c["bristle_stiffness"]),
        _entry("leakage_internal", coefficient=max(c["leakage_internal"], 0.0)),
        _entry(
            "sensor_lag",
            sensor="load_force",
            bandwidth=c["load_cell_frequency"] / (2.0 * pi),
            damping=c["load_cell_damping"],
        ),
        _entry("valve_offset", current=c["valve_offset"]),
    ]
    if c["force_h_bias"]:
        entries.append(_entry("load_cell_bias", cell="hydraulic_force", force=c["force_h_bias"]))
    return entries


def _entry(identifier: str, **values: Any) -> dict[str, Any]:
    options = {name: value for name, value in values.items() if isinstance(value, str)}
    numbers = {name: value for name, value in values.items() if not isinstance(value, str)}
    return {"id": identifier, **options, "parameters": numbers}


def _left_out(constants: Mapping[str, float], learned: StructuredModel) -> list[str]:
    """Parts of the learned model that the baseline lacks, one sentence each."""
    notes = []
    gains = [constants[name] for name in GAINS]
    spread = (max(gains) - min(gains)) / (2.0 * sum(gains) / len(gains))
    if spread > GAIN_ALIKE:
        notes.append(f"the learned valve gains differ by {100 * spread:.2g} % around their mean, which was taken")
    last = learned.compiled[1]
    if last.w3.any() or last.b3.any():
        notes.append("the learned model's network, which adds to flows and force, is not part of the baseline")
    return notes
