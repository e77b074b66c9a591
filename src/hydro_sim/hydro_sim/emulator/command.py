# SPDX-License-Identifier: Apache-2.0
"""`ros2 run hydro_sim emulator`: the emulated bench on a serial line, or recorded offline. emulator.md."""

from __future__ import annotations

import argparse
import secrets
import sys
from collections.abc import Sequence
from pathlib import Path
from types import FrameType
from typing import get_args

import yaml

from hydro_bridge.bags.recording import RecordingError
from hydro_bridge.cli.console import writable, writable_folder
from hydro_bridge.errors import user_message
from hydro_bridge.process import endings
from hydro_bridge.settings import SettingsError, from_mapping, read_yaml
from hydro_sim.box.box import EMULATED_BOX, BoxConfig, Integral, box_details, box_info
from hydro_sim.box.firmware import Precision
from hydro_sim.emulator import offline
from hydro_sim.emulator.firmware import FirmwareLink, FirmwareMachine
from hydro_sim.emulator.line.faults import PRESETS, load_faults
from hydro_sim.emulator.line.link import BoxLink
from hydro_sim.emulator.line.terminal import Terminal, default_link
from hydro_sim.emulator.machine import Machine
from hydro_sim.emulator.realtime import ControlPipe, RealTime, raise_priority
from hydro_sim.emulator.truth.config import truth_to_mapping
from hydro_sim.files import load_force
from hydro_sim.model.bench import Bench


def main(arguments: Sequence[str] | None = None) -> int:
    """Entry point; returns the exit status: 0, or 2 after one sentence on what cannot be used."""
    options = _parser().parse_args(arguments)
    try:
        with endings.raised():
            _run(options)
    except (SettingsError, RecordingError, ValueError, OSError) as error:
        endings.complain(user_message(error))
        return 2
    except endings.Ended as ended:  # before it serves, or because it spins
        if ended.sentence:
            endings.complain(ended.sentence)
        return 128 + ended.number
    return 0


def _run(options: argparse.Namespace) -> None:
    if options.print_truth:
        truth = offline.truth(options.truth, _believed(options))
        print(yaml.safe_dump(truth_to_mapping(truth), sort_keys=False), end="")
    elif options.offline or options.batch:
        if options.firmware != "python":
            raise SettingsError("--firmware is for a serial line: offline the Python box runs")
        for job in _jobs(options):
            offline.run(job)
    else:
        _serve(options)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="emulator", description=__doc__, allow_abbrev=False)
    parser.add_argument("--truth", metavar="FILE", help="what the bench is made of (default: the default profile)")
    parser.add_argument("--bench", metavar="FILE", help="what the box believes, and the numbers of the "
                        "emulated bench where --truth has no others (default: the nominal bench)")  # fmt: skip
    parser.add_argument("--seconds", type=float, metavar="S", help="how long (default: until stopped)")
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of noise, random forces and link faults")
    parser.add_argument(
        "--integral", choices=get_args(Integral), default="bumpless", help="of the force law (default: bumpless)"
    )
    parser.add_argument("--print-truth", action="store_true", help="print the whole truth as YAML and stop")
    line = parser.add_argument_group("on a serial line, in real time")
    line.add_argument("--link", type=Path, metavar="PATH", help=f"where the port appears (default: {default_link()})")
    presets = ", ".join(PRESETS)
    line.add_argument("--faults", default="clean", metavar="FILE", help=f"what goes wrong: a file, or one of {presets}")
    line.add_argument(
        "--firmware", choices=("python", "c", "c-single"), default="python", help="what runs as the box: the compiled "
        "Python one, or the one in C (firmware/) in double or in single precision (default: python)",
    )  # fmt: skip
    line.add_argument("--control", type=Path, metavar="PATH", help="named pipe for orders such as 'unplug 2'")
    line.add_argument(
        "--load-force", type=Path, metavar="FILE", help="keep the last forces on the load there meanwhile, in front of "
        "its cell, for scoring only",
    )  # fmt: skip
    group = parser.add_argument_group("offline: as fast as the machine computes, the same samples to the bit")
    group.add_argument("--offline", action="store_true")
    group.add_argument("--out", type=writable_folder, metavar="BAG", help="folder of the recording, made here")
    group.add_argument(
        "--noise-free", type=writable, metavar="FILE.npz", help="also write the run without noise, for scoring only"
    )
    group.add_argument("--schedule", metavar="FILE", help="references and gains (default: 20 s of everything)")
    group.add_argument("--batch", metavar="FILE", help="many recordings: a list `jobs` with these options as keys")
    return parser


def _jobs(options: argparse.Namespace) -> list[offline.Job]:
    if options.batch:
        entries = read_yaml(options.batch).get("jobs")
        if not isinstance(entries, list):
            raise SettingsError(f"{options.batch} must hold a list under the key jobs")
        return [from_mapping(offline.Job, entry, f"jobs[{index}]") for index, entry in enumerate(entries)]
    if not options.out:
        raise SettingsError("--offline needs --out, the folder of the recording")
    keys = ("out", "truth", "schedule", "bench", "noise_free", "seconds", "seed", "integral")
    return [
        from_mapping(offline.Job, {**{key: getattr(options, key) for key in keys}, "out": str(options.out)}, "emulator")
    ]


def _believed(options: argparse.Namespace) -> Bench:
    return Bench.load(options.bench) if options.bench else Bench.nominal()


def _serve(options: argparse.Namespace) -> None:
    if options.out or options.schedule or options.noise_free:
        raise SettingsError("--out, --schedule and --noise-free record offline: add --offline")
    if options.seconds is not None and not 0.001 <= options.seconds < float("inf"):
        raise SettingsError(f"--seconds {options.seconds:g}: must be 0.001 s or more")
    if options.seed < 0:
        raise SettingsError(f"--seed {options.seed}: must be 0 or more")
    bench = _believed(options)
    box, truth = BoxConfig(integral=options.integral).of_bench(bench), offline.truth(options.truth, bench)
    faults, epoch = load_faults(options.faults), 1 + secrets.randbelow(0xFFFFFFFF)
    machine: Machine
    link: BoxLink
    if options.firmware == "python":
        machine = Machine(truth, bench, box, options.seed)
        machine.warm_up()
        details = box_details(bench, box, machine.sensors, epoch)
        info, terminal = box_info(bench, box, EMULATED_BOX), Terminal(options.link or default_link())
        told = (lambda: machine.refused, box.compensated, lambda: machine.law_state)
        link = BoxLink(terminal, info, faults, options.seed, details, *told)
    else:
        precision: Precision = "single" if options.firmware == "c-single" else "double"
        machine = FirmwareMachine(truth, bench, box, options.seed, precision, epoch)
        machine.warm_up()
        terminal = Terminal(options.link or default_link())
        link = FirmwareLink(terminal, machine.firmware, box_info(bench, box, EMULATED_BOX), faults, options.seed)
    control = ControlPipe(options.control) if options.control else None
    status = _show if sys.stderr.isatty() else None
    felt = load_force.create(options.load_force) if options.load_force else None
    running = RealTime(machine, link, faults, control, felt, status)
    stop = _stopper()
    print(
        f"port {terminal.path}, 1 kHz, {raise_priority()}: ros2 run hydro_bridge bridge --port {terminal.path}",
        flush=True,
    )
    try:
        running.run(options.seconds, lambda: bool(stop))
    finally:
        terminal.unplug()
        if control is not None:
            control.close()
        if options.load_force:
            options.load_force.unlink(missing_ok=True)
    pacer, samples = running.pacer, running.samples
    print(
        f"{samples} samples, {pacer.late} late by more than 1 ms (worst {1e3 * pacer.lateness.longest:.2f} ms, "
        f"{pacer.skipped:.1f} s skipped), {running.cpu / max(samples * 1e-3, 1e-3):.3f} s of CPU per second"
    )
    refused = machine.refused[0]
    print(link.summary() + (f"; {refused} values refused by the box" if refused else ""), flush=True)


def _stopper() -> list[int]:
    """Return a list that is no longer empty once a stop was requested."""
    asked: list[int] = []

    def ask(number: int, _: FrameType | None) -> None:
        endings.let_go_of_terminal()
        asked.append(number)

    endings.answer(ask)
    return asked


def _show(line: str) -> None:
    sys.stderr.write(f"\r{line}\x1b[K")
    sys.stderr.flush()
