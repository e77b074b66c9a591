# SPDX-License-Identifier: Apache-2.0
"""Every benchmark can be imported: what they use of the packages is still there."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PEERS = {"gymnasium"}
"""Of an environment of its own, imported at the top."""


def test_every_benchmark_imports(each: Callable[..., None]) -> None:
    modules = [path.relative_to(ROOT).with_suffix("") for path in ROOT.glob("benchmarks/**/*.py")]

    def check(module: Path) -> None:
        try:
            importlib.import_module(".".join(module.parts))
        except ModuleNotFoundError as error:
            if error.name not in PEERS:
                raise

    each([module for module in modules if "test" not in module.parts], check)
