# SPDX-License-Identifier: Apache-2.0
"""Schedules: segments of references and gains, and their one YAML form, checked whole as it is read.

What `ros2 run hydro_sim collect` plays into the graph and what the emulator records offline (schedule.md). A fade
of 0.3 s joins the segments (hydro_sim.box.reference).
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

import yaml

from hydro_bridge.signals import ReferenceSignal, Waveform
from hydro_sim.yaml_settings import ConfigError, choice, from_mapping, quantity, read_yaml, to_mapping


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


def save_schedule(segments: Sequence[Segment], path: str | Path) -> None:
    """Write a schedule as `load_schedule` reads it; missing folders are made."""
    Path(path).parent.mkdir(parents=True, exist_ok=True)
    text = yaml.safe_dump({"segments": [to_mapping(segment) for segment in segments]}, sort_keys=False)
    Path(path).write_text(text, encoding="utf-8")
