# SPDX-License-Identifier: Apache-2.0
"""What a command line asks for is known before anything heavy is imported: --help and a slip are answered at once."""

from __future__ import annotations

import re
import subprocess
import sys
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENTRY = re.compile(r'"(\w+) = hydro_bridge\.process\.start:main_of\.([\w.]+)"')
COMMANDS = [
    module
    for setup in sorted(ROOT.glob("src/hydro_*/setup.py"))
    for _, module in ENTRY.findall(setup.read_text(encoding="utf-8"))
]
WITHOUT_NUMBA = ("hydro_policy.nodes.evaluate", "hydro_policy.nodes.trainer")
PROBE = """
import sys
from hydro_bridge.process.start import MainOf
sys.argv = ["command", "--help"]
try:
    MainOf(%r)()
except SystemExit as ended:
    assert not ended.code, ended.code
print("torch" in sys.modules, "numba" in sys.modules)
"""


def test_help_of_a_command_imports_no_torch(each: Callable[..., None]) -> None:
    each(sorted(COMMANDS), starts_light)


def starts_light(module: str) -> None:
    probe = [sys.executable, "-c", PROBE % module]
    ended = subprocess.run(probe, capture_output=True, text=True, timeout=240, check=True)
    assert "usage: " in ended.stdout
    torch, numba = ended.stdout.split()[-2:]
    assert torch == "False"
    assert numba == "False" or module not in WITHOUT_NUMBA
