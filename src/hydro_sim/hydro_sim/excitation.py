# SPDX-License-Identifier: Apache-2.0
"""Schedules: segments of references and gains, and their YAML format, which is validated as a whole when read.

`ros2 run hydro_policy collect` plays them into the graph, the emulator records them offline (schedule.md). A fade
of 0.3 s joins the segments (protocol.md).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import asdict, dataclass
from math import log, pi
from pathlib import Path
from typing import Annotated, Literal, cast

import numpy as np
import yaml

from hydro_core.files.atomic import write_atomic
from hydro_core.settings import SettingsError, from_mapping, quantity, read_yaml
from hydro_core.signals import ReferenceSignal, Waveform
from hydro_sim.model.bench import NOMINAL

WaveformName = Literal["hold", "sine", "multisine", "smooth_step"]
"""Names of `Waveform` in YAML."""


@dataclass(frozen=True, kw_only=True)
class Reference:
    """A reference as plain data."""

    waveform: WaveformName = "sine"
    amplitude: Annotated[float, quantity("N", 0.0, 1e8)] = 0.0
    offset: Annotated[float, quantity("N", -1e8, 1e8)] = 0.0
    frequency: Annotated[float, quantity("Hz", 1e-3, 100.0)] = 1.0
    phase: Annotated[float, quantity("rad", -100.0, 100.0)] = 0.0

    @property
    def signal(self) -> ReferenceSignal:
        """Reference signal as sent to the box."""
        return ReferenceSignal(
            waveform=Waveform[self.waveform.upper()], amplitude=self.amplitude, offset=self.offset,
            frequency=self.frequency, phase=self.phase,
        )  # fmt: skip


@dataclass(frozen=True, kw_only=True)
class Segment(Reference):
    """One segment of a schedule: one reference and one pair of total gains."""

    seconds: Annotated[float, quantity("s", 1e-3, 36000.0)]
    kp: Annotated[float, quantity("1/s", -500.0, 500.0)] = 90.0
    ki: Annotated[float, quantity("1/s^2", -500.0, 500.0)] = 15.0
    delta_u: Annotated[float, quantity("A", -20.0, 20.0)] = 0.0


def load_schedule(path: str | Path) -> list[Segment]:
    """Load segments from a YAML file with a list under `segments`.

    Raises SettingsError: the file cannot be read, or a segment has an unknown key or a value out of range.
    """
    return parse_schedule(read_yaml(path), Path(path).name)


def parse_schedule(data: object, where: str) -> list[Segment]:
    """Return segments from plain YAML data; raises SettingsError like `load_schedule`."""
    entries = data.get("segments") if isinstance(data, dict) and set(data) == {"segments"} else None
    if not isinstance(entries, list) or not entries:
        raise SettingsError(f"{where} must hold one list of segments under the key segments")
    return [from_mapping(Segment, entry, f"{where}.segments[{index}]") for index, entry in enumerate(entries)]


def save_schedule(segments: Sequence[Segment], path: str | Path) -> None:
    """Write a schedule in the format of `load_schedule`; missing folders are created."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump({"segments": [asdict(segment) for segment in segments]}, sort_keys=False)
    write_atomic(Path(path), text.encode())


@dataclass(frozen=True, kw_only=True)
class ExcitationRange:
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
    """1/s, within the guard's limits; the emulated bench is stable to about 120 in small motions, less in large
    ones.
    """
    ki: tuple[float, float] = (5.0, 15.0)
    """1/s^2, within the guard's limits."""

    @classmethod
    def of_force(cls, force: float) -> ExcitationRange:
        """Return the defaults for a bench whose size has this force [N]."""
        share, usual = force / NOMINAL.force, cls()
        return cls(
            force_max=share * usual.force_max, offset_max=share * usual.offset_max,
            force_rate_max=share * usual.force_rate_max,
        )  # fmt: skip


WAVEFORM_SHARES = {Waveform.HOLD: 0.1, Waveform.SINE: 0.35, Waveform.MULTISINE: 0.4, Waveform.SMOOTH_STEP: 0.15}
"""Probability of each waveform."""
WAVEFORM_STEEPNESS = {Waveform.HOLD: 0.0, Waveform.SINE: 1.0, Waveform.MULTISINE: 1.8, Waveform.SMOOTH_STEP: 4.0}
"""Peak rate of each waveform over amplitude times 2 pi frequency (protocol.md)."""


def draw_schedule(seconds: float, seed: int, limits: ExcitationRange | None = None) -> list[Segment]:
    """Draw a random schedule of `seconds`, reproducible by `seed`."""
    limits, generator = limits or ExcitationRange(), np.random.default_rng(seed)
    segments: list[Segment] = []
    left = round(seconds, 3)
    while left > 0.0:
        length = min(round(float(generator.uniform(*limits.seconds)), 3), left)
        place = generator.choice(len(WAVEFORM_SHARES), p=list(WAVEFORM_SHARES.values()))
        waveform = list(WAVEFORM_SHARES)[int(place)]
        offset = generator.uniform(-limits.offset_max, limits.offset_max)
        frequency = np.exp(generator.uniform(log(limits.frequency[0]), log(limits.frequency[1])))
        steep = WAVEFORM_STEEPNESS[waveform] * 2.0 * pi * frequency
        largest = min(limits.force_max - abs(offset), limits.force_rate_max / max(steep, 1e-9))
        amplitude = generator.uniform(0.05, 1.0) * largest if waveform != Waveform.HOLD else 0.0
        drawn = {
            "amplitude": amplitude, "offset": offset, "frequency": frequency, "phase": generator.uniform(0.0, 2.0 * pi),
            "kp": generator.uniform(*limits.kp), "ki": generator.uniform(*limits.ki),
        }  # fmt: skip
        numbers = {name: round(float(number), 4) for name, number in drawn.items()}
        segments.append(Segment(seconds=length, waveform=cast("WaveformName", waveform.name.lower()), **numbers))
        left = round(left - length, 3)
    return segments
