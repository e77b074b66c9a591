# SPDX-License-Identifier: Apache-2.0
"""Where the box in C lies, and how its tests are compiled."""

from __future__ import annotations

import os
import subprocess
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent

CC = os.environ.get("CC", "gcc")
STRICT = ["-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
SANITIZE = ["-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
PRECISIONS = {"double": [], "single": ["-DHYDRO_SINGLE"]}


def build(source: Path, program: Path, *words: str) -> None:
    """Compile one program."""
    subprocess.run([CC, *STRICT, *words, str(source), "-o", str(program), "-lm"], check=True)
