# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_sim emulator`: the emulated bench on a serial line, or recorded offline. emulator.md."""

from __future__ import annotations

import argparse
import secrets
import time
from contextlib import ExitStack, closing
from pathlib import Path
from typing import get_args

from hydro_bridge.arguments import parse_arguments, ros_arguments
from hydro_bridge.plant_clock import parse_pace
from hydro_bridge.serial.port import Port, PortSettings
from hydro_core.cli.console import bounded_number, command, writable_folder
from hydro_core.process import termination
from hydro_core.settings import SettingsError
from hydro_sim.box.box import BoxConfig, Integral
from hydro_sim.box.firmware import Precision
from hydro_sim.emulator import offline
from hydro_sim.emulator.analogue import make_converters, serve
from hydro_sim.emulator.line.faults import PRESETS, load_faults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal, default_link
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.realtime import ControlPipe, RealtimeEmulator, request_realtime
from hydro_sim.excitation import load_schedule
from hydro_sim.files import load_force
from hydro_sim.model.bench import Bench


@command(ValueError, OSError)
def main() -> None:
    """Entry point."""
    options = parse_arguments(_parser(), "emulator", *ros_arguments())
    if options.offline:
        _record(options)
    elif options.analogue:
        _convert(options)
    else:
        _serve(options)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="emulator", description=__doc__, allow_abbrev=False)
    parser.add_argument("--truth", metavar="FILE", help="what the bench is made of (default: the default profile)")
    parser.add_argument("--bench", metavar="FILE", help="what the box believes, and the numbers of the "
                        "emulated bench where --truth has no others (default: the nominal bench)")  # fmt: skip
    parser.add_argument("--seconds", type=bounded_number(1e-3, 36000.0), metavar="S",
                        help="how long (default: until stopped, or the schedule)")  # fmt: skip
    parser.add_argument("--seed", type=bounded_number(0), default=0, metavar="N",
                        help="of noise, random forces, link faults")  # fmt: skip
    parser.add_argument("--integral", choices=get_args(Integral), default="bumpless",
                        help="of the force law (default: bumpless)")  # fmt: skip
    line = parser.add_argument_group("on a serial line")
    line.add_argument("--link", type=Path, metavar="PATH", help=f"where the port appears (default: {default_link()})")
    presets = ", ".join(PRESETS)
    line.add_argument("--faults", default="clean", metavar="FILE", help=f"what goes wrong: a file, or one of {presets}")
    line.add_argument("--precision", choices=get_args(Precision), default="double",
                      help="of the box's numbers (default: double)")  # fmt: skip
    line.add_argument("--pace", default="plant", metavar="PACE", help="plant: each sample waits for the host's answer "
                      "(default); real: real time; a number: that many times real time")  # fmt: skip
    line.add_argument("--control", type=Path, metavar="PATH", help="named pipe for orders such as 'unplug 2'")
    line.add_argument("--analogue", metavar="PORT", help="be only the plant with its converters, behind the second "
                      "port of a box on a microcontroller's core")  # fmt: skip
    line.add_argument("--load-force", type=Path, metavar="FILE", help="keep the last forces on the load there "
                      "meanwhile, in front of its cell, for scoring only")  # fmt: skip
    group = parser.add_argument_group("offline: as fast as the machine computes, the same samples to the bit")
    group.add_argument("--offline", action="store_true")
    group.add_argument("--out", type=writable_folder, metavar="BAG", help="folder of the recording, made here")
    group.add_argument("--schedule", metavar="FILE", help="references and gains (default: 20 s of everything)")
    return parser


def _record(options: argparse.Namespace) -> None:
    """Record offline into a folder; prints one line."""
    if not options.out:
        raise SettingsError("--offline needs --out, the folder of the recording")
    if options.precision != "double":
        raise SettingsError("--precision is for a serial line: offline the box computes in double precision")
    began, bench = time.perf_counter(), Bench.load(options.bench) if options.bench else Bench.nominal()
    truth = offline.load_truth_config(options.truth, bench)
    segments = load_schedule(options.schedule) if options.schedule else offline.default_schedule(bench)
    if options.seconds is not None:
        segments = offline.fit_duration(segments, options.seconds)
    box = offline.with_gain_limits_for(segments, BoxConfig(integral=options.integral).of_bench(bench))
    recording = offline.record_offline(truth, segments, bench=bench, box=box, seed=options.seed)
    offline.write_bag(options.out, recording, bench)
    print(f"{options.out}: {len(recording.states) * 1e-3:g} s of bench in {time.perf_counter() - began:.2f} s")


def _convert(options: argparse.Namespace) -> None:
    """Run plant and converters behind a core's port until it is stopped; print statistics at the end."""
    converters = make_converters(options.truth, options.bench, options.seed)
    with termination.signals_noted() as stop, ExitStack() as stack:
        control = stack.enter_context(closing(ControlPipe(options.control))) if options.control else None
        port = stack.enter_context(closing(Port(PortSettings(path=options.analogue))))
        port.open()
        print(f"converters on {options.analogue}, {request_realtime()}", flush=True)
        serve(converters, port, control, options.seconds, lambda: bool(stop))
    print(f"{converters.conversions} samples, {converters.alone} without the core", flush=True)


def _serve(options: argparse.Namespace) -> None:
    """Run the bench on a serial line until it is stopped; print the port, and statistics at the end."""
    if options.out or options.schedule:
        raise SettingsError("--out and --schedule record offline: add --offline")
    bench, pace = Bench.load(options.bench) if options.bench else Bench.nominal(), parse_pace(options.pace)
    box, truth = BoxConfig(integral=options.integral).of_bench(bench), offline.load_truth_config(options.truth, bench)
    faults, epoch = load_faults(options.faults), 1 + secrets.randbelow(0xFFFFFFFF)
    machine = Machine(truth, bench, box, options.seed, precision=options.precision, epoch=epoch)
    machine.warm_up()
    terminal = Terminal(options.link or default_link())
    link = BoxLink(terminal, machine.box, faults, options.seed)
    control = ControlPipe(options.control) if options.control else None
    felt = load_force.create_ring(options.load_force) if options.load_force else None
    running = RealtimeEmulator(machine, link, pace, control, felt)
    told = "each sample waits for its host" if pace is None else f"{pace:g} times real time"
    told = f"1 kHz, {request_realtime()}" if pace == 1.0 else told
    print(f"port {terminal.path}, {told}: ros2 run hydro_bridge bridge --port {terminal.path}", flush=True)
    try:
        with termination.signals_noted() as stop:
            running.run(options.seconds, lambda: bool(stop))
    finally:
        terminal.unplug()
        if control is not None:
            control.close()
        if options.load_force:
            options.load_force.unlink(missing_ok=True)
    timer, samples = running.timer, running.samples
    late = (
        f", {timer.late} late by more than 1 ms (worst {1e3 * timer.lateness.longest:.2f} ms, {timer.skipped:.1f} s "
        "skipped)" if pace is not None else ""
    )  # fmt: skip
    print(f"{samples} samples{late}, {running.cpu / max(samples * 1e-3, 1e-3):.3f} s of CPU per second")
    refused = machine.box.refused[0]
    print(link.summary() + (f"; {refused} values refused by the box" if refused else ""), flush=True)
