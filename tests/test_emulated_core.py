# SPDX-License-Identifier: Apache-2.0
"""The box on an emulated microcontroller: it keeps the protocol, and what its controller's faults come to."""

from __future__ import annotations

import re
import subprocess
import sys
import time
from collections.abc import Callable, Iterator
from contextlib import closing, suppress
from pathlib import Path
from typing import Any

import pytest

from hydro_bridge.conformance.command import FAIL, PASS, Run
from hydro_bridge.conformance.host import Host, SilenceError
from hydro_bridge.ros.companion import executable_path
from hydro_bridge.serial.port import Port, PortSettings
from hydro_bridge.serial.protocol import State
from hydro_core.files import bench_digest
from hydro_core.signals import Flag, Law, Waveform
from tests import emulated_core
from tests.checks import ran
from tests.emulated_core import Core

pytestmark = pytest.mark.skipif(
    bool(emulated_core.MISSING),
    reason=f"the box on an emulated core is not tried: {', '.join(emulated_core.MISSING)} is not here "
    "(apt-get install gcc-arm-none-eabi libnewlib-arm-none-eabi qemu-system-arm)",
)
IN_TIME = ("hello.answered", "idle.values", "order.old", "refused", "measured.units")
"""Cases that judge by samples alone, whatever else the machine does."""
CREEP = 3e-3
"""m that the piston may go on by itself, of 15 that 300 N are: the oil relaxes while the valve is shut."""
X, F, U = 6, 2, 8  # places of position, load force and valve current in a sample


def numbers() -> dict[str, Any]:
    return bench_digest.read_parameters(Path(str(bench_digest.shipped_bench_file())))


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return emulated_core.build(tmp_path_factory.mktemp("box"))


@pytest.fixture(scope="module")
def board(box: Path, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Core]:
    with emulated_core.core(box, tmp_path_factory.mktemp("core")) as made:
        yield made


@pytest.fixture
def host(board: Core) -> Iterator[Host]:
    with session(board) as made:
        yield made


def session(board: Core) -> closing[Host]:
    port = Port(PortSettings(path=str(board.port)))
    port.open()
    made = Host(port, moving=True)
    made.close = port.close  # type: ignore[method-assign]  # the port alone: a drill ends as it ends
    return closing(made)


def drive(host: Host) -> State:
    """Greet, arm, and hold 300 N."""
    host.commands.clear()  # their numbers come again behind a restart
    host.greet(3000)
    host.sequence = host.states[-1].last_command + 1000
    host.send(arm=False)
    until(host, lambda state: not state.flags & (Flag.TRIPPED | Flag.WATCHDOG))
    host.send(arm=True, waveform=Waveform.HOLD, offset=300.0)
    until(host, lambda state: bool(state.flags & Flag.ARMED))
    return until(host, lambda state: bool(state.flags & Flag.ARMED) and abs(state.values[F] - 300.0) < 30.0)


def rest(host: Host, last: State, samples: int = 100) -> list[State]:
    """Samples behind a fault, while the host goes on asking for 300 N: disarmed, no current, no way."""
    begin = len(host.states)
    host.receive(samples, times=1)
    seen = host.states[begin:]
    assert not any(state.flags & Flag.ARMED for state in seen)
    assert {state.values[U] for state in seen} == {0.0}
    assert abs(seen[-1].values[X] - last.values[X]) < CREEP
    return seen


def until(host: Host, there: Callable[[State], bool], times: int = 1) -> State:
    """Go on until a sample is so."""
    for _ in range(3000):
        host.receive(1, times=times)
        if there(host.states[-1]):
            return host.states[-1]
    raise AssertionError(host.states[-1])


def restarted(host: Host, before: State) -> None:
    """Receive until the core has come up again, whose clock begins anew."""
    epoch = host.details.epoch
    with suppress(SilenceError):
        until(host, lambda state: state.time_us < before.time_us)
    rest(host, before)
    assert host.details.epoch not in (0, epoch), "its HELLO came by itself, of another power-on"
    drive(host)


def test_its_stack_is_two_kibibytes_at_most(board: Core, host: Host) -> None:
    drive(host)
    for waveform in (Waveform.SINE, Waveform.MULTISINE, Waveform.SMOOTH_STEP):
        host.send(waveform=waveform, amplitude=50.0, offset=100.0, law=Law.COMPENSATED)
        host.receive(50, times=1)
    host.greet(3000)
    used = board.stack()
    print(f"deepest stack {used} bytes")
    assert 500 < used < 2048


@pytest.mark.study
def test_what_a_sample_costs_and_how_far_it_is_from_the_library(tmp_path: Path) -> None:
    """Instructions by QEMU's counter, printed; the same to single precision's last places."""
    emulated_core.configure(tmp_path)
    made = ran(executable_path("hydro_filter", "export_c"), "--out", tmp_path / "filter_config.h")
    assert made.returncode == 0, made.stderr
    done = subprocess.run(
        [sys.executable, "-m", "benchmarks.core_figures", tmp_path], capture_output=True, text=True, check=True
    )
    print(done.stdout)
    shares = {line.split(":")[0]: line for line in done.stdout.splitlines()}
    for kind in ("greeting", "multisine", "compensated", "fade"):
        assert float(re.search(r"([\d.]+)% at", shares[kind])[1]) < 30.0
        assert float(re.search(r"current ([^,]+)", shares[kind])[1]) < 1e-8


@pytest.mark.study
def test_it_keeps_the_whole_protocol_and_moves(board: Core) -> None:
    """Each case passes, or is not judged: its host was late."""
    with closing(Port(PortSettings(path=str(board.port)))) as port:
        port.open()
        rows = Run(lambda: Host(port, bench=numbers(), moving=True)).start()
    assert {row["case"]: row["found"] for row in rows if row["result"] == FAIL} == {}
    assert sum(row["result"] == PASS for row in rows) > len(rows) // 2


def test_it_keeps_the_protocol(board: Core) -> None:
    with closing(Port(PortSettings(path=str(board.port)))) as port:
        port.open()
        rows = Run(lambda: Host(port, bench=numbers()), IN_TIME).start()
    assert [row for row in rows if row["result"] == FAIL] == []
    assert sum(row["result"] == PASS for row in rows) >= 3, [row["case"] + " " + row["found"] for row in rows]


def test_a_power_cut_at_300_newton_ends_disarmed(board: Core, host: Host) -> None:
    last = drive(host)
    board.order("off")
    time.sleep(0.3)
    board.order("on")
    restarted(host, last)


def test_a_loop_that_hangs_is_restarted_and_comes_up_disarmed(tmp_path: Path) -> None:
    program = emulated_core.build(tmp_path, flags="-DHYDRO_HANG")
    with emulated_core.core(program, tmp_path) as board, session(board) as host:
        last = drive(host)
        epoch = host.details.epoch
        until(host, lambda state: state.time_us < last.time_us)
        rest(host, last)
        assert host.details.epoch not in (0, epoch)


def test_a_host_that_goes_dark_finds_it_tripped(board: Core) -> None:
    with session(board) as host:
        last = drive(host)
    time.sleep(0.5 * emulated_core.SLOWNESS)
    with session(board) as host:
        host.receive(50)
        assert all(state.flags & Flag.TRIPPED and state.flags & Flag.WATCHDOG for state in host.states)
        rest(host, last)
        drive(host)


def test_bytes_that_are_lost_are_told_and_too_many_trip(board: Core, host: Host) -> None:
    last = drive(host)
    board.order("loss 0.001")
    host.receive(150, times=1)
    assert host.states[-1].flags & Flag.ARMED, "a command in ten is lost"
    assert host.decoder.counts.crc_errors + host.decoder.counts.malformed > 0
    board.order("loss 0.2")
    time.sleep(0.5 * emulated_core.SLOWNESS)
    board.order("loss 0")
    until(host, lambda state: bool(state.flags & Flag.TRIPPED))
    rest(host, last)
    drive(host)


@pytest.mark.parametrize("fault", ["stuck load_force", "beyond pressure_a", "lost piston_position"])
def test_a_converter_that_fails_trips(board: Core, host: Host, fault: str) -> None:
    last = drive(host)
    board.order(fault)
    found = until(host, lambda state: bool(state.flags & Flag.SENSOR_FAULT))
    assert found.flags & Flag.TRIPPED
    host.receive(100, times=1)
    assert {state.values[U] for state in host.states[-100:]} == {0.0}
    board.order("clear")
    host.receive(50, times=1)
    rest(host, last)
    drive(host)
