# SPDX-License-Identifier: Apache-2.0
"""What an offline recording does: segments of references and gains, and their YAML form."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_sim.emulator.parameters import SAMPLE_TIME
from hydro_sim.emulator.settings import ConfigError, choice, from_mapping, quantity, read_yaml


@dataclass(frozen=True, kw_only=True)
class Segment:
    """A stretch of a recording: one reference and one pair of gains (in all, not added to the box's)."""

    seconds: float = quantity(unit="s", low=1e-3, high=36000.0)
    waveform: str = choice("sine", *(waveform.name.lower() for waveform in Waveform))
    amplitude: float = quantity(0.0, unit="N", low=0.0, high=5000.0)
    offset: float = quantity(0.0, unit="N", low=-5000.0, high=5000.0)
    frequency: float = quantity(1.0, unit="Hz", low=1e-3, high=100.0)
    phase: float = quantity(0.0, unit="rad", low=-100.0, high=100.0)
    kp: float = quantity(90.0, unit="1/s", low=-500.0, high=500.0)
    ki: float = quantity(15.0, unit="1/s^2", low=-500.0, high=500.0)
    delta_u: float = quantity(0.0, unit="A", low=-0.1, high=0.1)

    @property
    def signal(self) -> ReferenceSignal:
        """The reference as it is sent to the box."""
        return ReferenceSignal(
            waveform=Waveform[self.waveform.upper()],
            amplitude=self.amplitude,
            offset=self.offset,
            frequency=self.frequency,
            phase=self.phase,
        )

    @classmethod
    def of(cls, signal: ReferenceSignal, seconds: float, kp: float = 90.0, ki: float = 15.0) -> Segment:
        """A segment that tracks `signal` for `seconds` with gains `kp` [1/s] and `ki` [1/s^2]."""
        return cls(
            seconds=seconds,
            waveform=Waveform(signal.waveform).name.lower(),
            amplitude=signal.amplitude,
            offset=signal.offset,
            frequency=signal.frequency,
            phase=signal.phase,
            kp=kp,
            ki=ki,
        )


DEFAULT_SCHEDULE = (
    Segment(seconds=6.0, waveform="multisine", amplitude=280.0, frequency=0.7),
    Segment(seconds=4.0, waveform="sine", amplitude=250.0, frequency=1.5),
    Segment(seconds=4.0, waveform="smooth_step", amplitude=200.0, frequency=0.5),
    Segment(seconds=4.0, waveform="sine", amplitude=150.0, offset=100.0, frequency=0.5),
    Segment(seconds=2.0, waveform="hold", offset=-100.0),
)
"""20 s with something of everything."""


def load_schedule(path: str | Path) -> list[Segment]:
    """Segments from a YAML file with a list under `segments`.

    Raises
    ------
    ConfigError
        If the file cannot be read or a segment has an unknown key or a value out of range.
    """
    return schedule_from(read_yaml(path), Path(path).name)


def schedule_from(data: object, where: str) -> list[Segment]:
    """Segments from plain YAML data; raises ConfigError like `load_schedule`."""
    entries = data.get("segments") if isinstance(data, dict) and set(data) == {"segments"} else None
    if not isinstance(entries, list) or not entries:
        raise ConfigError(f"{where} must hold one list of segments under the key segments")
    return [from_mapping(Segment, entry, f"{where}.segments[{index}]") for index, entry in enumerate(entries)]


def fit_to(segments: Sequence[Segment], seconds: float) -> list[Segment]:
    """The segments, repeated or cut so that they last `seconds` in all."""
    result: list[Segment] = []
    left = seconds
    while left > 0.5 * SAMPLE_TIME:
        segment = segments[len(result) % len(segments)]
        result.append(replace(segment, seconds=min(segment.seconds, left)))
        left -= segment.seconds
    return result
