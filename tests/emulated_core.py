# SPDX-License-Identifier: Apache-2.0
"""The box on the core of a microcontroller that QEMU emulates, with `emulator --analogue` as its converters."""

from __future__ import annotations

import json
import os
import secrets
import shutil
import socket
import subprocess
import time
from collections.abc import Iterator
from contextlib import contextmanager, suppress
from pathlib import Path

import numpy as np

from hydro_bridge.ros.companion import executable_path
from hydro_sim.box.box import BoxConfig
from hydro_sim.box.header import render_header
from hydro_sim.model.bench import Bench

BOARD = Path(__file__).resolve().parent.parent / "firmware" / "boards" / "stm32f405"
MISSING = [tool for tool in ("arm-none-eabi-gcc", "arm-none-eabi-nm", "qemu-system-arm") if shutil.which(tool) is None]
PAINT = 0x57AC57AC
SLOWNESS = 6
"""Times slower than real time: two cores that others use, too, take and give a byte at a time."""


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

    def __init__(self, program: Path, folder: Path, slowness: int = SLOWNESS) -> None:
        self.program, self.folder, self.slowness = program, folder, slowness
        self.port, self._core = folder / "port", None
        words = ["--analogue", folder / "analogue", "--link", self.port, "--control", folder / "control",
                 "--pace", str(1.0 / slowness)]  # fmt: skip
        self._converters = subprocess.Popen(
            [executable_path("hydro_sim", "emulator"), *words], stdout=subprocess.PIPE, text=True
        )
        assert self._converters.stdout is not None
        assert "converters on" in self._converters.stdout.readline()

    def power_on(self) -> None:
        """Switch the core on, with nothing on its lines from before."""
        for name in ("line.in", "line.out", "analogue.in", "analogue.out"):
            end = os.open(self.folder / name, os.O_RDWR | os.O_NONBLOCK)
            with suppress(BlockingIOError):
                while os.read(end, 65536):
                    pass
            os.close(end)
        self._core = subprocess.Popen(
            ["qemu-system-arm", "-M", "netduinoplus2", "-kernel", self.program, "-display", "none", "-monitor", "none",
             "-serial", f"pipe:{self.folder / 'line'}", "-serial", f"pipe:{self.folder / 'analogue'}",
             "-device", f"loader,addr={address(self.program, 'kept')},data={secrets.randbits(32)},data-len=4",
             "-qmp", f"unix:{self.folder / 'qmp'},server=on,wait=off"],
            stdout=subprocess.DEVNULL,
        )  # fmt: skip

    def power_off(self) -> None:
        """Switch it off, in the middle of whatever it does."""
        if self._core is not None:
            self._core.kill()
            self._core.wait()
            self._core = None

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
        """Give the converters an order."""
        (self.folder / "control").write_text(text + "\n")

    def close(self) -> str:
        """Switch everything off; return what the converters say in the end."""
        self.power_off()
        self._converters.terminate()
        told, _ = self._converters.communicate(timeout=20)
        return told


@contextmanager
def core(program: Path, folder: Path, slowness: int = SLOWNESS) -> Iterator[Core]:
    """A board that is on."""
    made = Core(program, folder, slowness)
    try:
        made.power_on()
        time.sleep(0.5)
        yield made
    finally:
        made.close()
