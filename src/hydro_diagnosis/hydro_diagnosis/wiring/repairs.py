# SPDX-License-Identifier: Apache-2.0
"""Possible mistakes in wiring, naming and scaling of channels, and the column map that corrects each."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace

import numpy as np

from hydro_bridge.signals import FloatArray
from hydro_diagnosis.formats.units import QUANTITY, UNITS
from hydro_diagnosis.io.column_map import ColumnMap

Channels = Mapping[str, FloatArray]
"""By BenchState field, SI units, equally spaced, each of shape (n,)."""


@dataclass(frozen=True)
class Repair:
    """One mistake of one field and how to undo it."""

    field: str
    sentence: str
    """Description of the mistake."""

    def apply(self, channels: Channels, step: float) -> Channels:
        """The channels as they would be without the mistake; `step` is the sampling time in s."""
        raise NotImplementedError

    def edit(self, columns: ColumnMap) -> ColumnMap:
        """The map without the mistake."""
        raise NotImplementedError


@dataclass(frozen=True)
class Scale(Repair):
    """A wrong sign, unit or count: the field is `factor` times what was read, plus `offset` in SI units."""

    factor: float = 1.0
    offset: float = 0.0
    unit: str = ""
    """The unit in which it was recorded, where it is one."""

    def apply(self, channels: Channels, step: float) -> Channels:
        """See `Repair`."""
        return {**channels, self.field: self.factor * channels[self.field] + self.offset}

    def edit(self, columns: ColumnMap) -> ColumnMap:
        """See `Repair`."""
        source = columns.sources[self.field]
        si = UNITS.get(source.unit, 1.0)
        if self.unit and QUANTITY.get(source.unit or self.unit) == QUANTITY[self.unit] and not self.offset:
            return columns.changed(self.field, replace(source, unit=self.unit))
        steps = list(source.steps)
        if self.factor != 1.0:
            steps.append(("*", self.factor))
        if self.offset:
            steps.append(("+" if self.offset > 0.0 else "-", abs(self.offset) / si))
        return columns.changed(self.field, replace(source, steps=tuple(steps)))


@dataclass(frozen=True)
class Exchange(Repair):
    """Two fields whose columns were exchanged."""

    other: str = ""

    def apply(self, channels: Channels, step: float) -> Channels:
        """See `Repair`."""
        return {**channels, self.field: channels[self.other], self.other: channels[self.field]}

    def edit(self, columns: ColumnMap) -> ColumnMap:
        """See `Repair`."""
        here, there = columns.sources[self.field], columns.sources[self.other]
        return columns.changed(self.field, there).changed(self.other, here)


@dataclass(frozen=True)
class Advance(Repair):
    """A field that was recorded late (or early, if negative)."""

    delay: float = 0.0
    """s."""

    def apply(self, channels: Channels, step: float) -> Channels:
        """See `Repair`."""
        at = np.arange(len(channels[self.field]), dtype=np.float64)
        return {**channels, self.field: np.interp(at + self.delay / step, at, channels[self.field])}

    def edit(self, columns: ColumnMap) -> ColumnMap:
        """See `Repair`."""
        source = columns.sources[self.field]
        return columns.changed(self.field, replace(source, delay=source.delay + self.delay))


@dataclass(frozen=True)
class Rename(Repair):
    """A column that holds another field than it was taken for, or none: `becomes` is then empty."""

    becomes: str = ""

    def apply(self, channels: Channels, step: float) -> Channels:
        """See `Repair`."""
        others = {name: values for name, values in channels.items() if name != self.field}
        return {**others, self.becomes: channels[self.field]} if self.becomes else others

    def edit(self, columns: ColumnMap) -> ColumnMap:
        """See `Repair`."""
        source = columns.sources[self.field]
        without = columns.changed(self.field, None)
        return without.changed(self.becomes, source) if self.becomes else without


def reversed_sign(field: str) -> Scale:
    """A field with the wrong sign."""
    return Scale(field, f"{field} has the wrong sign", factor=-1.0)


def in_unit(field: str, unit: str) -> Scale:
    """A field that is not in the SI unit."""
    return Scale(field, f"{field} is in {unit}", factor=UNITS[unit], unit=unit)
