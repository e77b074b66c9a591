# SPDX-License-Identifier: Apache-2.0
"""Possible mistakes in wiring, naming and scaling of channels, and the column map that corrects each.

A channel is doubtful if its values are implausible for the bench, copy another sensor's noise, or are a velocity. The
residuals select among the possible repairs (`stages.hypotheses`).
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from itertools import combinations
from typing import TYPE_CHECKING

import numpy as np

from hydro_core.signals import FloatArray
from hydro_diagnosis.bench_parameters import UnknownParameterError, guard_unknown
from hydro_diagnosis.io.column_map import ColumnMap
from hydro_diagnosis.io.columns import means
from hydro_diagnosis.io.units import to_si
from hydro_diagnosis.recording import MEASURED_CHANNELS
from hydro_sim.model.bench import Bench

if TYPE_CHECKING:
    from hydro_diagnosis.io.table import RawTable

Channels = Mapping[str, FloatArray]
"""Signals by BenchState field, SI units, equally spaced, each of shape (n,)."""


@dataclass(frozen=True)
class Repair:
    """Repair of a mistake in one field: its true value at t is `factor` x(t + `delay`) + `offset`, x as recorded.

    Or its column is exchanged with another field's (`exchanged_with`), or assigned to another field (`reassigned_to`).
    """

    field: str
    sentence: str
    """Description of the mistake."""
    factor: float = 1.0
    offset: float = 0.0
    """SI units."""
    unit: str = ""
    """Unit in which the field was recorded, if the mistake is a unit's."""
    delay: float = 0.0
    """Delay of the recorded field [s]; negative: early."""
    exchanged_with: str = ""
    """Field with which its column was exchanged; empty for none."""
    reassigned_to: str | None = None
    """Field that its column actually contains, empty to omit it; None: its own."""

    def apply(self, channels: Channels, step: float) -> Channels:
        """Return the repaired channels; `step`: sampling time [s]."""
        values = channels[self.field]
        if self.reassigned_to is not None:
            others = {name: one for name, one in channels.items() if name != self.field}
            return {**others, self.reassigned_to: values} if self.reassigned_to else others
        if self.exchanged_with:
            return {**channels, self.field: channels[self.exchanged_with], self.exchanged_with: values}
        if self.delay:
            at = np.arange(len(values), dtype=np.float64)
            values = np.interp(at + self.delay / step, at, values)
        return {**channels, self.field: self.factor * values + self.offset}

    def edit(self, columns: ColumnMap) -> ColumnMap:
        """Return the column map with the repair applied."""
        source = columns.sources[self.field]
        if self.reassigned_to is not None:
            without = columns.changed(self.field, None)
            return without.changed(self.reassigned_to, source) if self.reassigned_to else without
        if self.exchanged_with:
            there = columns.sources[self.exchanged_with]
            return columns.changed(self.field, there).changed(self.exchanged_with, source)
        if self.unit and not self.offset:
            return columns.changed(self.field, replace(source, unit=self.unit))
        offset = self.factor * source.offset + self.offset / to_si(source.unit)
        factor, delay = self.factor * source.factor, source.delay + self.delay
        return columns.changed(self.field, replace(source, factor=factor, offset=offset, delay=delay))


def reversed_sign(field: str) -> Repair:
    """Repair of a field with the wrong sign."""
    return Repair(field, f"{field} has the wrong sign", factor=-1.0)


def in_other_units(field: str, units: Sequence[str], taken: Mapping[str, str]) -> list[Repair]:
    """Repairs that read a field in each of `units`, except the present one; `taken`: present units by field."""
    here = taken.get(field, "")
    said = f", not {here}" if here else ""
    factors = {unit: to_si(unit) / to_si(here) for unit in units if unit != here}
    return [
        Repair(field, f"{field} is in {unit}{said}", factor=factor, unit=unit)
        for unit, factor in factors.items()
        if factor != 1.0
    ]


INSPECTED_SAMPLES = 200_000
"""Number of samples inspected, from the first."""
PLAUSIBLE_PRESSURES = (0.05, 3.0)
"""Plausible range of the highest pressure, relative to the supply pressure."""
UNIT_MISMATCH_RATIO = 1.5
"""Multiple of the stroke or largest current above which a value is taken to be in another unit."""
STROKE_MARGIN = 0.01
"""Share of the stroke by which a position may lie outside of it."""
MIN_CORRELATION = 0.9
"""Correlation above which a regression slope is used."""
BLOCK_SAMPLES = 10
"""Samples per block mean in regressions between channels."""

AlternativeRepairs = tuple[Repair, ...]
"""Alternative repairs of one field with implausible values, the likeliest first."""


@dataclass
class PlausibilityCheck:
    """Plausibility check of recordings: doubtful fields with their alternative repairs, and units."""

    doubts: list[AlternativeRepairs] = field(default_factory=list)
    """Alternative repairs of each field with implausible values."""
    units: dict[str, str] = field(default_factory=dict)
    """Unit of a field's column before conversion to SI, if stated."""


def check_plausibility(table: RawTable, bench: Bench) -> PlausibilityCheck:
    """Check the fields of a recording for plausibility; checks that need unknown parameters of `bench` are omitted."""
    found, bench, taken = PlausibilityCheck(units=dict(table.units)), guard_unknown(bench), table.units
    looked = {name: values[:INSPECTED_SAMPLES] for name, values in table.columns.items()}
    looked = {name: values for name, values in looked.items() if np.isfinite(values).sum() > 0.5 * len(values)}
    rows = np.all([np.isfinite(values) for values in looked.values()], axis=0)
    channels = {name: values[rows] for name, values in looked.items() if np.any(rows)}
    for doubts in (
        _copies(channels), _pressures(channels, bench, taken), _position(channels, bench, taken),
        _current(channels, bench, taken),
    ):  # fmt: skip
        with suppress(UnknownParameterError):
            for doubt in doubts:
                if doubt:
                    found.doubts.append(doubt)
    return found


def _copies(channels: Channels) -> Iterator[AlternativeRepairs]:
    """Pairs of channels with identical noise, which two sensors never have."""
    sensors = [
        name for name in (*MEASURED_CHANNELS, "valve_current") if name in channels and np.ptp(channels[name]) > 0.0
    ]
    for one, other in combinations(sensors, 2):
        if block_regression(channels[one], channels[other], 1)[1] < 1e-12:
            pairs = [(other, one), (one, other)]
            if (
                one == "pressure_a"
                and block_regression(channels.get("hydraulic_force", channels[one]), channels[one])[0] < 0.0
            ):
                pairs.reverse()  # falls as the force rises: likely pressure_b's column
            yield tuple(
                Repair(wrong, f"{wrong} holds the column of {right}: name its own, or leave it out", reassigned_to="")
                for wrong, right in pairs
            )


def _pressures(channels: Channels, bench: Bench, taken: Mapping[str, str]) -> Iterator[AlternativeRepairs]:
    supply = bench.supply_pressure
    for name in ("pressure_a", "pressure_b"):
        if name not in channels:
            continue
        share = float(np.quantile(channels[name], 0.99)) / supply
        alive = float(np.quantile(channels[name], 0.05)) > -0.02 * share * supply
        if alive and not PLAUSIBLE_PRESSURES[0] < share < PLAUSIBLE_PRESSURES[1]:
            units = in_other_units(name, ("Pa", "hPa", "kPa", "psi", "bar", "MPa"), taken)
            fitting = [one for one in units if PLAUSIBLE_PRESSURES[0] < one.factor * share < PLAUSIBLE_PRESSURES[1]]
            yield tuple(sorted(fitting, key=lambda one: abs(float(np.log(one.factor * share / 0.6)))))


def _position(channels: Channels, bench: Bench, taken: Mapping[str, str]) -> Iterator[AlternativeRepairs]:
    """Positions outside the stroke, which begins at 0, or too small for it."""
    if "piston_position" not in channels:
        return
    position, stroke = channels["piston_position"], bench.stroke
    low, high = float(position.min()) / stroke, float(position.max()) / stroke
    factor = 0.0  # scale of the position by the spring force
    zero = 0.5 * stroke - 0.5 * float(position.min() + position.max())  # m, by the travel, or below by the spring
    if "load_force" in channels:
        slope, left = block_regression(position, channels["load_force"])
        if not left > 1.0 - MIN_CORRELATION**2:
            factor = slope / bench.spring_stiffness
            rest = float(np.median(channels["load_force"] / bench.spring_stiffness - factor * position))
            zero = bench.spring_rest_position + rest
    if low >= -STROKE_MARGIN and high <= 1.0 + STROKE_MARGIN:
        if "piston_position" in taken and high < STROKE_MARGIN:
            yield tuple(_lengths(factor, max(-low, high), taken))
        return
    velocity = Repair("piston_position", "piston_position is the velocity", reassigned_to="piston_velocity")
    if max(-low, high) > UNIT_MISMATCH_RATIO:
        yield (velocity, *_lengths(factor, max(-low, high), taken))
        return
    sign = -1.0 if factor < 0.0 else 1.0
    judged = "the spring's force" if factor else "the middle of what it travels"
    which = " and the wrong sign" if sign < 0.0 else ""
    said = f"piston_position has its zero elsewhere{which} (judged by {judged}: write what was measured)"
    yield velocity, Repair("piston_position", said, factor=sign, offset=float(f"{zero:.3g}"))


def _lengths(factor: float, share: float, taken: Mapping[str, str]) -> Iterator[Repair]:
    """Units in which the position fits the stroke and the spring force, and the size of an encoder count."""
    for one in in_other_units("piston_position", ("m", "mm", "cm", "um", "in"), taken):
        if one.factor * share < 1.0 + STROKE_MARGIN and (not factor or 1.0 / 3.0 < abs(factor) / one.factor < 3.0):
            yield one
    if factor:
        size = float(f"{abs(factor):.2g}")
        yield Repair(
            "piston_position",
            f"piston_position is in counts of about {size:.2g} m (judged by the spring: write the encoder's own)",
            factor=size,
        )


def _current(channels: Channels, bench: Bench, taken: Mapping[str, str]) -> Iterator[AlternativeRepairs]:
    if "valve_current" not in channels:
        return
    largest, limit = float(np.max(np.abs(channels["valve_current"]))), bench.valve_current_max
    if largest > UNIT_MISMATCH_RATIO * limit:
        scales = (
            *in_other_units("valve_current", ("mA",), taken),
            Repair("valve_current", f"valve_current is in per cent of {limit:g} A", factor=limit / 100.0),
            Repair("valve_current", f"valve_current is in volts, 10 V for {limit:g} A", factor=limit / 10.0),
            Repair("valve_current", f"valve_current is a share of {limit:g} A", factor=limit),
        )
        yield tuple(one for one in scales if one.factor * largest <= UNIT_MISMATCH_RATIO * limit)


def block_regression(on: FloatArray, dependent: FloatArray, samples: int = BLOCK_SAMPLES) -> tuple[float, float]:
    """Return the regression slope of `dependent` on `on`, by means of `samples` each, and the residual variance share.

    0 and 1 if one of the signals is constant.
    """
    one, other = (means(values, samples) for values in (on, dependent))
    one, other = one - one.mean(), other - other.mean()
    size, power = float(one @ one), float(other @ other)
    if not size * power > 0.0:
        return 0.0, 1.0
    slope = float(one @ other) / size
    return slope, float(np.sum(np.square(other - slope * one))) / power
