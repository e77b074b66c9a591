# SPDX-License-Identifier: Apache-2.0
"""The box on the core of a microcontroller that QEMU emulates, run by `emulate.py`."""

from __future__ import annotations

import json
import shutil
import socket
import subprocess
import sys
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path

import numpy as np

from hydro_sim.box.box import BoxConfig
from hydro_sim.box.header import render_header
from hydro_sim.model.bench import Bench

BOARD = Path(__file__).resolve().parent.parent / "firmware" / "boards" / "stm32f405"
MISSING = [tool for tool in ("arm-none-eabi-gcc", "arm-none-eabi-nm", "qemu-system-arm") if shutil.which(tool) is None]
PAINT = 0x57AC57AC
SLOWNESS = 6
"""Times slower than real time, about, on two cores: each byte is taken and given by itself."""


def configure(folder: Path) -> None:
    """Write the configuration of a box of the nominal bench."""
    (folder / "box_config.h").write_text(render_header(BoxConfig().constants(Bench.nominal(), name="board")))


def build(folder: Path, program: str = "box", flags: str = "") -> Path:
    """A program of the board, for the nominal bench."""
    configure(folder)
    words = [f"CONFIG={folder / 'box_config.h'}", f"OUT={folder}", f"FLAGS={flags}", f"{folder / program}.elf"]
    done = subprocess.run(["make", "-B", "-C", BOARD, *words], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout + done.stderr
    return folder / f"{program}.elf"


def address(program: Path, name: str) -> int:
    """Where a variable lies."""
    table = subprocess.run(["arm-none-eabi-nm", program], capture_output=True, text=True, check=True).stdout
    return next(int(line.split()[0], 16) for line in table.splitlines() if line.split()[-1] == name)


class Core:
    """A board that can be switched on and off; its line is the port `folder`/port, as long as this lives."""

    def __init__(self, program: Path, folder: Path) -> None:
        self.program, self.folder, self.port = program, folder, folder / "port"
        words = [sys.executable, BOARD / "emulate.py", program, "--link", self.port, "--pace", str(1.0 / SLOWNESS)]
        self._process = subprocess.Popen(words, stdout=subprocess.PIPE, text=True)
        assert self._process.stdout is not None
        assert "port" in self._process.stdout.readline()

    def stack(self) -> int:
        """Bytes of the stack that were ever used: the others still have their paint."""
        first, end = (address(self.program, name) for name in ("_stack_begin", "_stack_end"))
        dump = self.folder / "stack"
        orders = [{"execute": "qmp_capabilities"}, {"execute": "pmemsave", "arguments": {
            "val": first, "size": end - first, "filename": str(dump)}}]  # fmt: skip
        with socket.socket(socket.AF_UNIX) as line:
            line.connect(str(self.folder / "qmp"))
            answers = line.makefile()
            answers.readline()
            for order in orders:
                line.sendall(json.dumps(order).encode())
                while "return" not in (answer := json.loads(answers.readline())):
                    assert "error" not in answer, answer
        words = np.frombuffer(dump.read_bytes(), np.uint32)
        return int(4 * (len(words) - np.argmax(words != PAINT)))

    def order(self, text: str) -> None:
        """Give an order: to the converters, to the line, or to switch on or off."""
        (self.folder / "port.control").write_text(text + "\n")

    def close(self) -> str:
        """Switch everything off; return what is said in the end."""
        self._process.terminate()
        told, _ = self._process.communicate(timeout=20)
        return told


@contextmanager
def core(program: Path, folder: Path) -> Iterator[Core]:
    """A board that is on."""
    made = Core(program, folder)
    try:
        yield made
    finally:
        made.close()
