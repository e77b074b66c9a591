# SPDX-License-Identifier: Apache-2.0
"""Compilation at set-up: each compiled entry point of the emulator is called once."""

from __future__ import annotations

from collections.abc import Callable

from hydro_sim import excitation
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile


def _emulator() -> None:
    truth = profile("default")
    machine = Machine(truth)
    machine.warm_up()
    machine.plant.step(0.0)
    record_offline(truth, excitation.draw(0.1, 0))


STEPS: dict[str, Callable[[], None]] = {"emulator": _emulator}
"""By the message shown while each runs."""
