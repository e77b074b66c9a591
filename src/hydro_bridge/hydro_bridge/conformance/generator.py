# SPDX-License-Identifier: Apache-2.0
"""Reference generator by protocol.md, fed with the commands that a box accepted."""

from __future__ import annotations

from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.waveforms import FADE, Point, faded, shape
from hydro_bridge.serial.frames import BoxInfo
from hydro_bridge.serial.protocol import State
from hydro_bridge.signals import STATE_FIELDS, Flag, ReferenceSignal, Waveform

_VALUE, _RATE = STATE_FIELDS.index("reference_force"), STATE_FIELDS.index("reference_force_rate")
_ROUNDING = 1e-6
"""s: rounding of the clock decides whether a fade ends at its 300th or 301st sample."""


class Generator:
    """Expected f_r and f_r': `force` is the field of the force that the law follows, `fade` [s] its cross-fade."""

    def __init__(self, force: str, fade: float) -> None:
        self.force = STATE_FIELDS.index(force)
        self.fade = fade
        self.armed = False
        self.old: tuple[ReferenceSignal, float] = (ReferenceSignal(), 0.0)
        self.new: tuple[ReferenceSignal, float] = (ReferenceSignal(), 0.0)

    def point(self, state: State, wanted: ReferenceSignal, time: float) -> Point | None:
        """Return the expected point at this sample; None while the box is not armed."""
        if not state.flags & Flag.ARMED:
            self.armed = False
            return None
        if not self.armed:
            self.armed = True
            self.old, self.new = (ReferenceSignal(offset=state.values[self.force]), time), (wanted, time)
        elif time - self.new[1] >= self.fade and wanted != self.new[0]:
            self.old, self.new = self.new, (wanted, time)
        points = [shape(signal, time - begun) for signal, begun in (self.old, self.new)]
        return faded(points[0], points[1], time - self.new[1])


def playable(signal: ReferenceSignal, force_range: float) -> bool:
    """Return whether a box with this force range [N] must accept the reference."""
    numbers = (signal.amplitude, signal.offset, signal.phase, signal.frequency)
    if not all(abs(number) < 3.4e38 for number in numbers):  # NaN, too
        return False
    if signal.amplitude < 0.0 or signal.amplitude + abs(signal.offset) > force_range:
        return False
    return signal.waveform is Waveform.HOLD or 0.0 < signal.frequency < 1000.0


def compare(host: Host, force: str, tolerance: float, rate_tolerance: float) -> str:
    """Describe where the box's reference differs [N], [N/s]; empty if right with either rounding of the fade's end."""
    made = [Generator(force, FADE + rounding) for rounding in (-_ROUNDING, _ROUNDING)]
    found = [_compare(host, tolerance, rate_tolerance, generator) for generator in made]
    return "" if "" in found else found[0]


def _compare(host: Host, tolerance: float, rate_tolerance: float, generator: Generator) -> str:
    info: BoxInfo | None = host.hello.info if host.hello else None
    reach = host.details.details.force_range if host.details else 0.0
    commands, seen = {each.sequence: each.command for each in host.sent}, 0
    wanted = ReferenceSignal()
    assert info is not None
    for state in host.states:
        command = commands.get(state.last_command)
        if command is not None and playable(command.reference, reach or 1e6):
            wanted = command.reference
        point = generator.point(state, wanted, state.time_us * 1e-6)
        if point is None:
            continue
        seen += 1
        for name, index, right, allowed in (
            ("reference_force", _VALUE, point[0], tolerance),
            ("reference_force_rate", _RATE, point[1], rate_tolerance),
        ):
            if not abs(state.values[index] - right) <= allowed + 1e-4 * abs(right):
                return f"{name} is {state.values[index]:g} in STATE {state.sequence}, {right:g} is right"
    return "" if seen else "it was not armed"
