# SPDX-License-Identifier: Apache-2.0
"""`emulator --analogue` on a serial device, as the second port of a real board would be."""

from __future__ import annotations

import os
import struct
import subprocess
import tty
from pathlib import Path

import numpy as np

from hydro_bridge.ros.companion import executable_path
from hydro_sim.emulator.analogue import checked
from tests.checks import ran

EMULATOR = executable_path("hydro_sim", "emulator")


def test_each_current_is_answered_by_five_readings_of_the_plant() -> None:
    """At 0 A the oil settles, at half of the largest current the piston goes; a damaged frame is no sample."""
    board, device = os.openpty()
    tty.setraw(device)
    words = [EMULATOR, "--analogue", os.ttyname(device), "--seconds", "0.2"]
    with subprocess.Popen(words, stdout=subprocess.PIPE, text=True) as process, os.fdopen(board, "r+b", 0) as line:
        assert process.stdout is not None
        assert "converters on" in process.stdout.readline()
        positions = []
        for n, count in enumerate([32768] * 100 + [32768 + 16384] * 100):
            line.write(checked(struct.pack("<BBH", 0x5A, n, count))[:-1] + b"\0" if n == 50 else b"")
            line.write(checked(struct.pack("<BBH", 0x5A, n, count)))
            answer = b""
            while len(answer) < 13:
                answer += line.read(13 - len(answer))
            assert answer == checked(answer[:12]) and answer[:2] == bytes((0xA5, n))
            positions.append(struct.unpack("<5H", answer[2:12])[4])
        assert process.stdout.read() == "200 samples, 0 without the core\n"
    os.close(device)
    rest, moved = np.ptp(positions[:100]), positions[-1] - positions[100]
    assert rest < 200 < 1000 < moved


def test_a_device_that_is_not_there_is_one_sentence(tmp_path: Path) -> None:
    done = ran(EMULATOR, "--analogue", tmp_path / "ttyUSB1")
    assert done.returncode != 0 and "ttyUSB1" in done.stderr and "Traceback" not in done.stderr
