# SPDX-License-Identifier: Apache-2.0
"""Schedules: segments of references and gains, their one YAML form, checked whole as it is read, and their coverage.

What `ros2 run hydro_sim collect` plays into the graph and what the emulator records offline (schedule.md). A fade
of 0.3 s joins the segments (hydro_sim.box.reference).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import accumulate
from math import log, pi
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
import yaml

from hydro_bridge.cli.console import Table
from hydro_bridge.files.atomic import write_whole
from hydro_bridge.settings import SettingsError, from_mapping, quantity, read_yaml, to_mapping
from hydro_bridge.signals import SAMPLE_PERIOD, Flag, ReferenceSignal, StateArray, Waveform
from hydro_bridge.size import Size
from hydro_sim.model.bench import NOMINAL
from hydro_sim.plotting import UNITS

WaveformName = Literal["hold", "sine", "multisine", "smooth_step"]
"""`Waveform` in YAML."""


@dataclass(frozen=True, kw_only=True)
class Segment:
    """One segment of a schedule: one reference and one pair of total gains."""

    seconds: Annotated[float, quantity("s", 1e-3, 36000.0)]
    waveform: WaveformName = "sine"
    amplitude: Annotated[float, quantity("N", 0.0, 1e8)] = 0.0
    offset: Annotated[float, quantity("N", -1e8, 1e8)] = 0.0
    frequency: Annotated[float, quantity("Hz", 1e-3, 100.0)] = 1.0
    phase: Annotated[float, quantity("rad", -100.0, 100.0)] = 0.0
    kp: Annotated[float, quantity("1/s", -500.0, 500.0)] = 90.0
    ki: Annotated[float, quantity("1/s^2", -500.0, 500.0)] = 15.0
    delta_u: Annotated[float, quantity("A", -20.0, 20.0)] = 0.0

    @property
    def signal(self) -> ReferenceSignal:
        """Return the reference as it is sent to the box."""
        return ReferenceSignal(
            waveform=Waveform[self.waveform.upper()],
            amplitude=self.amplitude,
            offset=self.offset,
            frequency=self.frequency,
            phase=self.phase,
        )


def load_schedule(path: str | Path) -> list[Segment]:
    """Load segments from a YAML file with a list under `segments`.

    Raises SettingsError: the file cannot be read, or a segment has an unknown key or a value out of range.
    """
    return schedule_from(read_yaml(path), Path(path).name)


def schedule_from(data: object, where: str) -> list[Segment]:
    """Return segments from plain YAML data; raises SettingsError like `load_schedule`."""
    entries = data.get("segments") if isinstance(data, dict) and set(data) == {"segments"} else None
    if not isinstance(entries, list) or not entries:
        raise SettingsError(f"{where} must hold one list of segments under the key segments")
    return [from_mapping(Segment, entry, f"{where}.segments[{index}]") for index, entry in enumerate(entries)]


def save_schedule(segments: Sequence[Segment], path: str | Path) -> None:
    """Write a schedule as `load_schedule` reads it; missing folders are made."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump({"segments": [to_mapping(segment) for segment in segments]}, sort_keys=False)
    write_whole(Path(path), text.encode())


class Playback:
    """Plays segments by the plant's armed samples: while it is disarmed the schedule pauses."""

    def __init__(self, schedule: Sequence[Segment]) -> None:
        self._schedule = list(schedule)
        self._ends = list(accumulate(segment.seconds for segment in schedule))
        self._index, self._samples = -1, 0
        self._clean = False
        self.flags = 0
        """Flags of the last sample."""
        self.trips = 0
        self.trips_in_a_row = 0
        """Trips since the last segment that was played from its beginning to its end without one."""

    @property
    def seconds(self) -> float:
        """Length of the schedule [s]."""
        return self._ends[-1]

    @property
    def elapsed(self) -> float:
        """Time played [s]."""
        return self._samples * SAMPLE_PERIOD

    @property
    def finished(self) -> bool:
        """Whether the last segment has ended."""
        return self._index == len(self._schedule)

    def on_sample(self, flags: int) -> None:
        """Process a sample's flags. Nothing before the first segment is counted."""
        before, self.flags = self.flags, flags
        if self._index < 0:
            return
        self._samples += bool(self.flags & Flag.ARMED)
        if self.flags & ~before & Flag.TRIPPED:
            self.trips, self.trips_in_a_row, self._clean = self.trips + 1, self.trips_in_a_row + 1, False

    def next(self) -> Segment | None:
        """Return the segment that begins now, if one does."""
        index = max(self._index, 0)
        while index < len(self._ends) and self.elapsed >= self._ends[index]:
            index += 1
        if index == self._index:
            return None
        self.trips_in_a_row = 0 if self._clean else self.trips_in_a_row
        self._index, self._clean = index, True
        return None if self.finished else self._schedule[index]


@dataclass(frozen=True, kw_only=True)
class Range:
    """Ranges of the excitation. The defaults do not trip the nominal bench or the emulator's default truth."""

    seconds: tuple[float, float] = (2.0, 6.0)
    """s, of one segment."""
    force_max: float = NOMINAL.force * 22.0 / 15.0
    """N, |offset| + amplitude."""
    offset_max: float = NOMINAL.force * 11.0 / 15.0
    """N, |offset|."""
    force_rate_max: float = NOMINAL.force * 40.0 / 3.0
    """N/s, peak of the reference's rate."""
    frequency: tuple[float, float] = (0.15, 4.0)
    """Hz, drawn evenly on a logarithmic scale."""
    kp: tuple[float, float] = (15.0, 75.0)
    """1/s, what the guard lets through; the emulated bench is stable to about 120 in small motions, less in large
    ones.
    """
    ki: tuple[float, float] = (5.0, 15.0)
    """1/s^2, what the guard lets through."""

    @classmethod
    def of_force(cls, force: float) -> Range:
        """Return the defaults for a bench whose size has this force [N]."""
        share, usual = force / NOMINAL.force, cls()
        return cls(
            force_max=share * usual.force_max, offset_max=share * usual.offset_max,
            force_rate_max=share * usual.force_rate_max,
        )  # fmt: skip


SHARES = {Waveform.HOLD: 0.1, Waveform.SINE: 0.35, Waveform.MULTISINE: 0.4, Waveform.SMOOTH_STEP: 0.15}
"""Probability of each waveform."""

STEEPNESS = {Waveform.HOLD: 0.0, Waveform.SINE: 1.0, Waveform.MULTISINE: 1.8, Waveform.SMOOTH_STEP: 4.0}
"""Peak rate of each waveform over amplitude times 2 pi frequency (hydro_sim.box.reference)."""


def draw(seconds: float, seed: int, limits: Range | None = None) -> list[Segment]:
    """Draw a schedule of that length [s]; the same seed gives the same one."""
    limits, generator = limits or Range(), np.random.default_rng(seed)
    segments: list[Segment] = []
    left = round(seconds, 3)
    while left > 0.0:
        length = round(float(generator.uniform(*limits.seconds)), 3)
        segments.append(_segment(min(length, left), limits, generator))
        left = round(left - segments[-1].seconds, 3)
    return segments


def _segment(seconds: float, limits: Range, generator: np.random.Generator) -> Segment:
    waveform = list(SHARES)[int(generator.choice(len(SHARES), p=list(SHARES.values())))]
    offset = generator.uniform(-limits.offset_max, limits.offset_max)
    frequency = np.exp(generator.uniform(log(limits.frequency[0]), log(limits.frequency[1])))
    steep = STEEPNESS[waveform] * 2.0 * pi * frequency
    largest = min(limits.force_max - abs(offset), limits.force_rate_max / max(steep, 1e-9))
    amplitude = generator.uniform(0.05, 1.0) * largest if waveform != Waveform.HOLD else 0.0
    phase, kp, ki = generator.uniform(0.0, 2.0 * pi), generator.uniform(*limits.kp), generator.uniform(*limits.ki)
    numbers = (round(float(number), 4) for number in (amplitude, offset, frequency, phase, kp, ki))
    amplitude, offset, frequency, phase, kp, ki = numbers
    name = cast("WaveformName", waveform.name.lower())
    return Segment(
        seconds=seconds, waveform=name, amplitude=amplitude, offset=offset, frequency=frequency, phase=phase, kp=kp,
        ki=ki,
    )  # fmt: skip


WORKING_RANGE: dict[str, tuple[str, float, float]] = {
    "load_force": ("force", -400.0, 400.0),
    "load_force_rate": ("force", -3770.0, 3770.0),
    "pressure_a": ("pressure", 4e6, 9e6),
    "pressure_b": ("pressure", 5e6, 14e6),
    "piston_position": ("length", 0.02, 0.06),
    "piston_velocity": ("length", -0.19, 0.19),
    "valve_current": ("current", -5e-3, 5e-3),
    "proportional_gain": ("", 15.0, 75.0),
    "integral_gain": ("", 5.0, 15.0),
}
"""Scale of `Size`, and working range of a model of the nominal bench: 300 N at 2 Hz with offsets (physics.md), SI."""


def working_range(size: Size) -> dict[str, tuple[float, float]]:
    """Return the working range of a model of a bench of this size, SI units."""
    shares = {name: getattr(size, name) / getattr(NOMINAL, name) for name in vars(NOMINAL)} | {"": 1.0}
    return {field: (shares[scale] * low, shares[scale] * high) for field, (scale, low, high) in WORKING_RANGE.items()}


BINS = 20


def coverage(states: StateArray, size: Size) -> Table:
    """One row per quantity: its range, its spread, and how much of the bench's working range was visited while armed.

    `visited` is the share of 20 bins of the working range with at least 0.1 % of the samples; the last row is the share
    of cells of load force by velocity, 10 each way, within the ellipse that sines of 400 N and 3770 N/s fill (on the
    nominal bench).
    """
    armed = states[(states["flags"] & Flag.ARMED) != 0]
    seconds = 1e-3 * len(armed)
    columns = {
        "quantity": "", "unit": "", "low": "0.1 % of samples are below", "high": "0.1 % of samples are above",
        "std": "standard deviation", "visited": "share of the working range visited",
    }  # fmt: skip
    table = Table(columns, title=f"{seconds:g} s armed of {1e-3 * len(states):g} s")
    ranges = working_range(size)
    for field in ranges:
        name, unit, factor = UNITS[field]
        values = armed[field]
        low, high = np.quantile(values, [0.001, 0.999])
        counts, _ = np.histogram(values, BINS, ranges[field])
        table.add(
            quantity=name, unit=unit, low=float(factor * low), high=float(factor * high),
            std=float(factor * values.std()),
            visited=float((counts > 0.001 * len(values)).mean()),
        )  # fmt: skip
    table.add(quantity="force by velocity", unit="", low=np.nan, high=np.nan, std=np.nan, visited=_plane(armed, size))
    return table


def _plane(armed: StateArray, size: Size) -> float:
    ranges = [working_range(size)[field] for field in ("load_force", "piston_velocity")]
    counts, force, velocity = np.histogram2d(armed["load_force"], armed["piston_velocity"], 10, ranges)
    f, v = 0.5 * (force[1:] + force[:-1]) / ranges[0][1], 0.5 * (velocity[1:] + velocity[:-1]) / ranges[1][1]
    inside = f[:, None] ** 2 + v[None, :] ** 2 <= 1.0
    return float((counts[inside] >= 10).mean())
