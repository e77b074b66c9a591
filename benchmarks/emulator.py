# SPDX-License-Identifier: Apache-2.0
"""CPU of one emulated second: on the serial line with a reader that commands at 1 kHz, and offline.

CPU by os.times (user and system) of the emulator's process; the goal for the serial line is below 0.15 s.
"""

from __future__ import annotations

import multiprocessing
import os
import sys
import tempfile
import time
from pathlib import Path

from benchmarks._report import finish, parser
from hydro_bridge.serial.port import Port, PortLostError, PortSettings
from hydro_bridge.serial.protocol import State, encode_command, encode_hello
from hydro_bridge.serial.stream import Decoder
from hydro_bridge.signals import Command, ReferenceSignal, Waveform
from hydro_sim.box.box import EMULATED_BOX, BoxConfig, box_info
from hydro_sim.emulator.line.faults import LinkFaults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.realtime import RealTime, raise_priority
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation.schedules import Segment
from hydro_sim.model.bench import Bench

SINE = ReferenceSignal(waveform=Waveform.SINE, amplitude=300.0, frequency=1.0)


def cpu() -> float:
    """CPU time [s] of this process so far."""
    spent = os.times()
    return spent.user + spent.system


def command_back(path: str, seconds: float) -> None:
    """Answer each state with a command, as the bridge does."""
    port, decoder, sent = Port(PortSettings(path=path)), Decoder(), 0
    port.open()
    port.write(encode_hello(1, 0))
    end = time.monotonic() + seconds
    try:
        while time.monotonic() < end:
            for frame in decoder.feed(port.read(0.1)):
                if isinstance(frame, State):
                    sent += 1
                    port.write(
                        encode_command(sent, 0, Command(arm=sent > 20, delta_kp=75.0, delta_ki=10.0, reference=SINE))
                    )
    except PortLostError:
        return  # the emulator has ended


def serial(seconds: float) -> dict[str, float]:
    """The real-time loop with all that belongs to it."""
    machine = Machine(profile("default"))
    machine.warm_up()
    with tempfile.TemporaryDirectory() as folder:
        terminal = Terminal(Path(folder) / "port")
        link = BoxLink(terminal, box_info(Bench.nominal(), BoxConfig(), EMULATED_BOX), LinkFaults())
        reader = multiprocessing.get_context("spawn").Process(
            target=command_back, args=(str(terminal.path), seconds + 30.0)
        )
        reader.start()
        while link.report.hellos == 0:
            link.poll(0.0)
            time.sleep(0.01)
        priority = raise_priority()
        began = cpu()
        timing = RealTime(machine, link, LinkFaults()).run(seconds, lambda: False)
        spent = cpu() - began
        terminal.unplug()
        reader.join()
    share, late, worst = link.report.commands / timing.samples, timing.pacer.late, timing.pacer.lateness.longest
    print(
        f"serial line, {priority}: {spent / seconds:.3f} s of CPU per s; {late} of {timing.samples} samples "
        f"late by more than 1 ms, worst {1e3 * worst:.2f} ms; {share:.1%} of the samples with a new command"
    )
    return {
        "cpu": spent / seconds,
        "late": late,
        "worst": worst,
        "commanded": share,
    }


def offline(seconds: float) -> float:
    """The compiled loop."""
    segment = Segment(seconds=seconds, amplitude=300.0)
    record_offline(profile("default"), [Segment(seconds=0.1)])
    began = cpu()
    record_offline(profile("default"), [segment])
    spent = (cpu() - began) / seconds
    print(f"offline: {spent:.4f} s of CPU per s, {1 / spent:.0f} times real time")
    return spent


def main(arguments: list[str] | None = None) -> int:
    """Measure, print, write."""
    options = parser("emulator", __doc__)
    options.add_argument("--seconds", type=float, default=20.0, help="emulated time of each part (default 20)")
    asked = options.parse_args(arguments)
    result = {"offline": offline(asked.seconds), "serial": serial(asked.seconds)}
    finish({"unit": "s of CPU per s", **result}, asked.json)
    return 0


if __name__ == "__main__":
    sys.exit(main())
