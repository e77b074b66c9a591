# SPDX-License-Identifier: Apache-2.0
"""The box in C by itself: its own tests, a short hostile run, full coverage of the guarded parts, its examples."""

from __future__ import annotations

import subprocess
import sys
from importlib import import_module
from pathlib import Path
from types import ModuleType

import pytest

from hydro_bridge.conformance.command import FAIL, PASS, Run
from hydro_bridge.conformance.host import Host
from hydro_core.files import bench_digest
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.header import render_header
from hydro_sim.emulator.line.terminal import Terminal
from hydro_sim.model.bench import Bench
from tests.checks import compiled

FIRMWARE = Path(__file__).resolve().parent.parent / "firmware"
IN_TIME = ("framing", "hello", "idle", "clamp", "order", "refused", "watchdog.hold")
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
    checks.hostile(tmp_path, 30_000)


def test_every_line_and_branch_of_the_box_is_reached(checks: ModuleType, tmp_path: Path) -> None:
    found = checks.coverage(tmp_path)
    assert {part: found[part].missed for part in checks.BOX} == dict.fromkeys(checks.BOX, ())
    assert sum(found[part].branches for part in checks.BOX) > 250


def example(name: str, folder: Path, *words: str) -> Path:
    header = render_header(BoxConfig().constants(Bench.nominal(), name="linux box"))
    (folder / "box_config.h").write_text(header)
    return compiled(FIRMWARE / "examples" / f"{name}.c", folder / name, f"-I{FIRMWARE}", f"-I{folder}", *words)


def test_the_frame_for_a_microcontroller_compiles(tmp_path: Path) -> None:
    for words in ((), ("-DHYDRO_SINGLE",)):
        example("bare_metal", tmp_path, "-O2", "-c", "-ffreestanding", *words)


def test_box_filter_and_policy_go_into_one_file(tmp_path: Path) -> None:
    headers = [f'#include "hydro/{one.name}"' for one in sorted((FIRMWARE / "hydro").glob("*.h"))]
    units = "#define HYDRO_POLICY_UNITS 8"  # by the header of the weights
    (tmp_path / "all.c").write_text("\n".join([units, *headers, "int hydro_all;", ""]))
    compiled(tmp_path / "all.c", tmp_path / "all.o", "-c", f"-I{FIRMWARE}")


class Line(Terminal):
    """The host's end of the pseudo-terminal that the box opens."""

    def read(self, timeout: float = 0.0) -> bytes:
        self.wait(timeout)
        return super().read()

    def write(self, data: bytes) -> bool:
        return super().write(data) == len(data)


@pytest.mark.graph
def test_the_box_for_linux_keeps_the_protocol_over_a_port(tmp_path: Path) -> None:
    program, line = example("linux_serial", tmp_path, "-O2"), Line(tmp_path / "port")
    numbers = bench_digest.read_parameters(Path(str(bench_digest.shipped_bench_file())))
    with subprocess.Popen([program, line.path, "60"], stdout=subprocess.DEVNULL) as process:
        rows = Run(lambda: Host(line, bench=numbers), IN_TIME).start()
        process.terminate()
    assert [row for row in rows if row["result"] == FAIL] == []
    assert sum(row["result"] == PASS for row in rows) >= 10, [row["case"] + " " + row["found"] for row in rows]
