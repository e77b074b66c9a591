# SPDX-License-Identifier: Apache-2.0
"""What a command line asks for is known before anything heavy is imported: --help and a slip are answered at once."""

from __future__ import annotations

import re
import subprocess
import sys
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
ENTRY = re.compile(r'"(\w+) = hydro_bridge\.process\.start:main_of\.([\w.]+)"')
COMMANDS = [module for _, module in ENTRY.findall((ROOT / "src/hydro_policy/setup.py").read_text(encoding="utf-8"))]
"""The other packages import no torch."""
WITHOUT_NUMBA = ("hydro_policy.nodes.evaluate", "hydro_policy.nodes.trainer")
PROBE = """
import importlib, os, sys
from hydro_bridge.process.start import MainOf
for name in sys.argv[1].split():
    importlib.import_module(name)
for module in sys.argv[2:]:
    sys.stdout.flush()
    if os.fork():
        os.wait()
        continue
    sys.argv = ["command", "--help"]
    try:
        MainOf(module)()
    except SystemExit as ended:
        assert not ended.code, ended.code
    print("probed", module, "torch" in sys.modules, "numba" in sys.modules, flush=True)
    os._exit(0)
"""
"""One process forks for each command what all of them import."""


def test_help_of_a_command_imports_no_torch() -> None:
    rest = sorted(set(COMMANDS) - set(WITHOUT_NUMBA))
    light, others = helped("numpy", *WITHOUT_NUMBA), helped("numpy numba scipy.optimize", *rest)
    assert light == dict.fromkeys(WITHOUT_NUMBA, (False, False))
    assert others == dict.fromkeys(rest, (False, True))


def helped(preloaded: str, *modules: str) -> dict[str, tuple[bool, bool]]:
    """Ask each command for help; returns whether torch and numba were imported, of those that showed it."""
    probe = [sys.executable, "-c", PROBE, preloaded, *modules]
    shown = subprocess.run(probe, capture_output=True, text=True, timeout=240, check=True).stdout
    found = re.findall(r"^usage: [^\0]*?^probed (\S+) (\w+) (\w+)$", shown, re.MULTILINE)
    return {module: (torch == "True", numba == "True") for module, torch, numba in found}
