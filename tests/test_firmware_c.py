# SPDX-License-Identifier: Apache-2.0
"""The box in C by itself: its own tests, a short hostile run, full coverage of the guarded parts, its examples."""

from __future__ import annotations

import os
import subprocess
import tty
from collections.abc import Iterator
from pathlib import Path
from types import ModuleType

import pytest

from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.run import FAIL, PASS, run
from hydro_bridge.conformance.script import shipped
from hydro_bridge.files import bench_file
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.configuration import header, values
from hydro_sim.model.bench import Bench
from hydro_sim.model.sensors import Sensors
from tests.firmware_filter import FIRMWARE, firmware_module

IN_TIME = ("framing", "hello", "version", "idle", "clamp", "order.repeated", "order.old", "refused", "watchdog.hold")
"""Cases that judge by samples alone, whatever else the machine does."""


@pytest.fixture(scope="module")
def checks() -> ModuleType:
    return firmware_module("checks")


def test_its_own_tests_pass_in_both_precisions(checks: ModuleType, tmp_path: Path) -> None:
    checks.unit(tmp_path)


def test_hostile_bytes_raise_nothing_and_move_nothing(checks: ModuleType, tmp_path: Path) -> None:
    checks.hostile(tmp_path, 100_000)


def test_every_line_and_branch_of_the_box_is_reached(checks: ModuleType, tmp_path: Path) -> None:
    found = checks.coverage(tmp_path)
    assert {part: found[part].missed for part in checks.BOX} == dict.fromkeys(checks.BOX, ())
    assert sum(found[part].branches for part in checks.BOX) > 250


def test_a_function_that_nothing_calls_is_not_reached(checks: ModuleType, tmp_path: Path) -> None:
    part, program = tmp_path / "hydro" / "part.h", tmp_path / "program.c"
    part.parent.mkdir()
    part.write_text("static inline int used(void)\n{\n    return 0;\n}\nstatic int other(void)\n{\n    return 1;\n}\n")
    program.write_text('#include "hydro/part.h"\nint main(void)\n{\n    return used() ? other() : 0;\n}\n')
    assert checks.coverage(tmp_path, program)["part.h"].missed == ("part.h:5", "part.h:7")
    program.write_text('#include "hydro/part.h"\nint main(void)\n{\n    return used();\n}\n')
    part.write_text(part.read_text().replace("static int", "static inline int"))
    assert checks.coverage(tmp_path, program)["part.h"].missed == ("part.h:5", "part.h:7")


def test_the_mutator_makes_mutants_that_die(checks: ModuleType) -> None:
    text = "static inline bool late(int age)\n{\n    return 2 * age > 50;\n}\n"
    made = {mutant.change: mutant.text for mutant in checks.mutation.mutants(text)}
    assert "return 2 * age >= 50;" in made["> -> >="] and "return 2 * age > 51;" in made["50 -> 51"]
    assert "return 2 / age > 50;" in made["* -> /"]


def test_each_mutant_that_is_said_to_change_nothing_is_one(checks: ModuleType) -> None:
    for label in checks.EQUIVALENT:
        part, becomes = label.split(": ", 1)
        made = [mutant.becomes for mutant in checks.mutation.mutants((FIRMWARE / "hydro" / part).read_text())]
        assert becomes in made, f"{part} has no mutant {becomes!r}"


def test_without_a_tool_the_checks_say_so_in_one_line(checks: ModuleType, monkeypatch, capsys) -> None:  # type: ignore[no-untyped-def]
    monkeypatch.setattr(checks.shutil, "which", lambda tool: None if tool == "valgrind" else tool)
    monkeypatch.setattr(checks.sys, "argv", ["checks.py"])
    assert checks.main() == 2
    assert capsys.readouterr().err == "not found: valgrind; --no-operations leaves out what needs valgrind\n"


@pytest.fixture
def configured(tmp_path: Path) -> Path:
    text = header(values(Bench.nominal(), BoxConfig(), Sensors(), "linux box"))
    (tmp_path / "box_config.h").write_text(text)
    return tmp_path


def compiled(folder: Path, source: Path, *words: str) -> Path:
    program = folder / source.stem
    strict = ["-std=c99", "-O2", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
    places = [f"-I{FIRMWARE}", f"-I{folder}"]
    compiler = os.environ.get("CC", "cc")
    subprocess.run([compiler, *strict, *places, *words, str(source), "-o", str(program), "-lm"], check=True)
    return program


def test_the_frame_for_a_microcontroller_compiles(configured: Path) -> None:
    for words in ((), ("-DHYDRO_SINGLE",)):
        compiled(configured, FIRMWARE / "examples" / "bare_metal.c", "-c", "-ffreestanding", *words)


class End:
    """The far end of a pseudo-terminal as a line."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor
        os.set_blocking(descriptor, False)

    def read(self, timeout: float) -> bytes:
        import select

        if not select.select([self.descriptor], [], [], timeout)[0]:
            return b""
        try:
            return os.read(self.descriptor, 65536)
        except OSError:
            return b""

    def write(self, frame: bytes) -> bool:
        return os.write(self.descriptor, frame) == len(frame)


@pytest.fixture
def linux_box(configured: Path) -> Iterator[End]:
    program = compiled(configured, FIRMWARE / "examples" / "linux_serial.c")
    near, far = os.openpty()
    tty.setraw(far)
    process = subprocess.Popen([str(program), os.ttyname(far), "60"], stdout=subprocess.PIPE)
    yield End(near)
    process.terminate()
    process.wait()
    os.close(near)
    os.close(far)


@pytest.mark.graph
def test_the_box_for_linux_keeps_the_protocol_over_a_port(linux_box: End) -> None:
    cases = [case for case in shipped() if case.id.startswith(IN_TIME)]
    numbers = bench_file.read_numbers(Path(str(bench_file.shipped())))
    results = run(cases, lambda: Host(linux_box), numbers, moving=False)
    assert [(result.case.id, result.found) for result in results if result.outcome == FAIL] == []
    assert sum(result.outcome == PASS for result in results) >= 18


def test_a_signal_ends_the_box_for_linux_behind_its_loop(configured: Path) -> None:
    program = compiled(configured, FIRMWARE / "examples" / "linux_serial.c")
    near, far = os.openpty()
    tty.setraw(far)
    end, process = End(near), subprocess.Popen([str(program), os.ttyname(far)], stdout=subprocess.PIPE, text=True)
    assert end.read(20.0)  # it runs
    process.terminate()
    said, _ = process.communicate(timeout=20)
    os.close(near)
    os.close(far)
    assert process.returncode == 0 and "samples, 0 commands taken" in said


def test_two_starts_of_the_box_for_linux_have_two_epochs(configured: Path) -> None:
    text = (FIRMWARE / "examples" / "linux_serial.c").read_text().replace('"../hydro/box.h"', '"hydro/box.h"')
    source = configured / "epochs.c"
    source.write_text(
        text.replace("int main(", "int box(") + 'int main(void) { return printf("%u", drawn_epoch()) < 0; }'
    )
    program = compiled(configured, source)
    found = {subprocess.run([str(program)], capture_output=True, check=True).stdout for _ in range(3)}
    assert len(found) == 3 and b"0" not in found
