# SPDX-License-Identifier: Apache-2.0
"""The box in C by itself: its own tests, a short hostile run, full coverage of the guarded parts, its examples."""

from __future__ import annotations

import subprocess
import sys
import time
from collections.abc import Iterator
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from hydro_bridge.conformance.command import FAIL, PASS, run_cases, shipped_cases
from hydro_bridge.conformance.host import Host
from hydro_core.files import bench_digest
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.header import render_header
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.model.bench import Bench
from tests.checks import compiled

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
IN_TIME = ("framing", "hello", "version", "idle", "clamp", "order.repeated", "order.old", "refused", "watchdog.hold")
"""Cases that judge by samples alone, whatever else the machine does."""


@pytest.fixture(scope="module")
def checks() -> ModuleType:
    """Of firmware/test, whose modules find one another by their folder."""
    sys.path.insert(0, str(FIRMWARE / "test"))
    try:
        return import_module("checks")
    finally:
        sys.path.remove(str(FIRMWARE / "test"))


def test_its_own_tests_pass_in_both_precisions(checks: ModuleType, tmp_path: Path) -> None:
    checks.unit(tmp_path)


def test_hostile_bytes_raise_nothing_and_move_nothing(checks: ModuleType, tmp_path: Path) -> None:
    checks.hostile(tmp_path, 100_000)


def test_every_line_and_branch_of_the_box_is_reached(checks: ModuleType, tmp_path: Path) -> None:
    found = checks.coverage(tmp_path)
    assert {part: found[part].missed for part in checks.BOX} == dict.fromkeys(checks.BOX, ())
    assert sum(found[part].branches for part in checks.BOX) > 250


@pytest.fixture
def configured(tmp_path: Path) -> Path:
    text = render_header(BoxConfig().constants(Bench.nominal(), name="linux box"))
    (tmp_path / "box_config.h").write_text(text)
    return tmp_path


def example(name: str, folder: Path, *words: str) -> Path:
    source, places = FIRMWARE / "examples" / f"{name}.c", (f"-I{FIRMWARE}", f"-I{folder}")
    return compiled(source, folder / name, "-O2", *places, *words)


def test_the_frame_for_a_microcontroller_compiles(configured: Path) -> None:
    for words in ((), ("-DHYDRO_SINGLE",)):
        example("bare_metal", configured, "-c", "-ffreestanding", *words)


def test_box_filter_and_policy_go_into_one_file(tmp_path: Path) -> None:
    headers = [f'#include "hydro/{one.name}"' for one in sorted((FIRMWARE / "hydro").glob("*.h"))]
    units = "#define HYDRO_POLICY_UNITS 8"  # by the header of the weights
    (tmp_path / "all.c").write_text("\n".join([units, *headers, "int hydro_all;", ""]))
    compiled(tmp_path / "all.c", tmp_path / "all.o", "-c", f"-I{FIRMWARE}")


class End(Terminal):
    """The far end of a pseudo-terminal as a line."""

    def read(self, timeout: float = 0.0) -> bytes:
        end = time.monotonic() + timeout
        while not (data := super().read()) and time.monotonic() < end:
            time.sleep(1e-4)
        return data

    def write(self, data: bytes) -> bool:
        return super().write(data) == len(data)


@pytest.fixture
def linux_box(configured: Path) -> Iterator[End]:
    program, port = example("linux_serial", configured), configured / "port"
    line = End(port)
    with subprocess.Popen([str(program), str(port), "60"], stdout=subprocess.DEVNULL) as process:
        yield line
        process.terminate()
    line.unplug()


@pytest.mark.graph
def test_the_box_for_linux_keeps_the_protocol_over_a_port(linux_box: End) -> None:
    cases = [case for case in shipped_cases() if case.id.startswith(IN_TIME)]
    numbers = bench_digest.read_numbers(Path(str(bench_digest.shipped_bench_file())))
    results = run_cases(cases, lambda: Host(linux_box), numbers, moving=False)
    assert [(result.case.id, result.found) for result in results if result.outcome == FAIL] == []
    assert sum(result.outcome == PASS for result in results) >= 18
