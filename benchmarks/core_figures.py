# SPDX-License-Identifier: Apache-2.0
"""Figures of the box on an emulated STM32F405: `core_figures FOLDER`, which has box_config.h and filter_config.h.

Instructions of a sample by QEMU's counter, the largest difference from the same program on this machine, bytes of flash
and RAM, and the deepest stack that the compiler knows of.
"""

from __future__ import annotations

import os
import re
import struct
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path
from typing import Any

BOARD = Path(__file__).resolve().parents[1] / "firmware" / "boards" / "stm32f405"
BUDGET = 168_000
"""Cycles of a millisecond."""
CYCLES = 1.7
"""Cycles an instruction, assumed: loads and branches take two and more, divisions and roots 14, and the flash waits."""
STATES = ("current", "f_c", "M_c")


def make(folder: Path, program: str) -> Path:
    """Build a program of the board."""
    words = [f"CONFIG={folder / 'box_config.h'}", f"OUT={folder}", f"{folder / program}.elf"]
    subprocess.run(["make", "-s", "-B", "-C", BOARD, *words], check=True, stdout=subprocess.DEVNULL)
    return folder / f"{program}.elf"


def samples(*words: str | Path) -> Iterator[tuple[str, int, tuple[float, ...]]]:
    """Kind, counts of SysTick, and the three values, as a program writes them."""
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as program:
        assert program.stdout is not None
        for line in program.stdout:
            if line.startswith("."):
                break
            kind, counts, *bits = line.split()
            yield kind, int(counts, 16), tuple(struct.unpack("<f", struct.pack("<I", int(one, 16)))[0] for one in bits)
        program.terminate()


def measure(folder: Path) -> dict[str, dict[str, Any]]:
    """Mean and worst instructions by kind, and the largest differences from the library in single precision."""
    core = make(folder, "figures")
    words = ["-std=c99", "-O2", "-ffp-contract=off", "-DHYDRO_SINGLE", "-DHYDRO_LIBRARY", f"-I{BOARD.parents[1]}"]
    here = folder / "figures"
    subprocess.run(
        [os.environ.get("CC", "gcc"), *words, f"-I{folder}", BOARD / "figures.c", "-o", here, "-lm"], check=True
    )
    emulator = ["qemu-system-arm", "-M", "netduinoplus2", "-icount", "shift=3", "-display", "none", "-monitor", "none"]
    found: dict[str, dict[str, Any]] = {}
    for (kind, counts, there), (_, _, library) in zip(
        samples(*emulator, "-serial", "stdio", "-kernel", core), samples(here), strict=True
    ):
        row = found.setdefault(kind, {"instructions": [], "differences": dict.fromkeys(STATES, 0.0)})
        row["instructions"].append(counts * 125 / 168)
        for name, one, other in zip(STATES, there, library, strict=True):
            row["differences"][name] = max(row["differences"][name], abs(one - other))
    return {kind: row | {"mean": sum(row["instructions"]) / len(row["instructions"]),
                         "worst": max(row["instructions"])} for kind, row in found.items()}  # fmt: skip


def sizes(program: Path) -> tuple[int, int]:
    """Bytes of flash and of RAM, without the stack."""
    done = subprocess.run(["arm-none-eabi-size", program], check=True, capture_output=True, text=True)
    text, data, bss = (int(word) for word in done.stdout.splitlines()[1].split()[:3])
    return text + data, data + bss


def frames(program: Path) -> dict[str, int]:
    """Bytes of stack by function, as the compiler counts them."""
    found = {}
    for line in next(program.parent.glob(f"*{program.stem}.su")).read_text().splitlines():
        place, size, _ = line.split("\t")
        found[re.split(":", place)[-1]] = int(size)
    return found


def main() -> None:
    """Entry point."""
    folder = Path(sys.argv[1]).resolve()
    for program in ("box", "figures"):
        flash, ram = sizes(made := make(folder, program))
        deepest = sorted(frames(made).items(), key=lambda pair: -pair[1])[:4]
        print(f"{program}: {flash} bytes of flash, {ram} of RAM; frames {deepest}")
    for kind, row in measure(folder).items():
        shares = (
            f"{row['worst'] / BUDGET:.1%} of a millisecond, {CYCLES * row['worst'] / BUDGET:.1%} at {CYCLES} cycles"
        )
        told = ", ".join(f"{name} {value:.2g}" for name, value in row["differences"].items())
        print(f"{kind}: {row['mean']:.0f} instructions, worst {row['worst']:.0f}: {shares}; differences {told}")


if __name__ == "__main__":
    main()
