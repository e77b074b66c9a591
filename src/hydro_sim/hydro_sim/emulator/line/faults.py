# SPDX-License-Identifier: Apache-2.0
"""Fault injection on a serial line, with seeded probabilities: one `FaultyLine` for each direction.

Probabilities are per frame. The unit is one frame up (box to bridge), and down the bytes of one read, mostly one frame.
"""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, fields
from pathlib import Path
from typing import Annotated

import numpy as np

from hydro_core.settings import SettingsError, from_mapping, quantity, read_yaml


@dataclass(frozen=True, kw_only=True)
class LinkFaults:
    """Fault probabilities per frame, for both directions. All zero: a clean line."""

    corrupt: Annotated[float, quantity("-", 0.0, 1.0)] = 0.0  # one to eight bits flip
    lose: Annotated[float, quantity("-", 0.0, 1.0)] = 0.0  # one byte is missing
    truncate: Annotated[float, quantity("-", 0.0, 1.0)] = 0.0  # the end is missing
    drop: Annotated[float, quantity("-", 0.0, 1.0)] = 0.0  # all of it is missing
    duplicate: Annotated[float, quantity("-", 0.0, 1.0)] = 0.0  # it comes twice
    reorder: Annotated[float, quantity("-", 0.0, 1.0)] = 0.0  # it comes after the next
    noise: Annotated[float, quantity("-", 0.0, 1.0)] = 0.0  # up to 64 random bytes before it


PRESETS = {
    "clean": LinkFaults(),
    "noisy": LinkFaults(corrupt=0.005, lose=0.002, drop=0.005, duplicate=0.002, reorder=0.002),
    "awful": LinkFaults(corrupt=0.05, lose=0.02, truncate=0.02, drop=0.05, duplicate=0.02, reorder=0.02, noise=0.02),
}
FAULT_NAMES = tuple(entry.name for entry in fields(LinkFaults))


def load_faults(name: str) -> LinkFaults:
    """Return the faults of a preset or a YAML file; raises SettingsError if `name` is neither."""
    if name in PRESETS:
        return PRESETS[name]
    if not Path(name).exists():
        raise SettingsError(f"--faults {name} is neither a file nor one of {', '.join(PRESETS)}")
    return from_mapping(LinkFaults, read_yaml(name), Path(name).name)


class FaultyLine:
    """One direction of the line.

    `faults`: probabilities; may be replaced at any time. `generator`: source of randomness.
    """

    QUEUE_BYTES_MAX = 1 << 16  # bytes queued during a stall; further ones are lost

    def __init__(self, faults: LinkFaults, generator: np.random.Generator) -> None:
        self.faults = faults
        self.counts = dict.fromkeys((*FAULT_NAMES, "overflow"), 0)
        self._random = generator
        self.stalled_until = 0.0
        """s, time until which the line is blocked; 0: not blocked."""
        self._held = b""
        self._waiting: deque[bytes] = deque()

    @property
    def faulty(self) -> bool:
        """Whether frames may be lost here."""
        return bool(self._held) or any(getattr(self.faults, name) for name in FAULT_NAMES)

    def clear(self) -> None:
        """Discard the frames in transit, as the line was unplugged."""
        self._waiting.clear()
        self._held = b""
        self.stalled_until = 0.0

    def transmit(self, chunk: bytes, now: float) -> bytes:
        """Put `chunk`, possibly empty, on the line, and return the bytes that arrive by `now` [s]."""
        out = self._disturb(chunk) if chunk and self.faulty else chunk
        if now < self.stalled_until:
            if sum(map(len, self._waiting)) + len(out) <= self.QUEUE_BYTES_MAX:
                self._waiting.append(out)
            else:
                self.counts["overflow"] += 1
            return b""
        self.stalled_until = 0.0
        out = b"".join([*self._waiting, out])
        self._waiting.clear()
        return out

    def _happens(self, name: str) -> bool:
        chance = getattr(self.faults, name)
        happens = chance > 0.0 and self._random.random() < chance
        self.counts[name] += happens
        return bool(happens)

    def _disturb(self, frame: bytes) -> bytes:
        held, self._held = self._held, b""
        if self._happens("drop"):
            return held
        data = bytearray(frame)
        if self._happens("corrupt"):
            for bit in self._random.integers(0, 8 * len(data), self._random.integers(1, 9)):
                data[bit // 8] ^= 1 << bit % 8
        if self._happens("lose"):
            del data[self._random.integers(len(data))]
        if self._happens("truncate"):
            del data[self._random.integers(len(data) + 1) :]
        out = bytes(data)
        if self._happens("noise"):
            out = self._random.bytes(int(self._random.integers(1, 65))) + out
        if self._happens("duplicate"):
            out += out
        if not held and self._happens("reorder"):
            self._held = out
            return b""
        return out + held
