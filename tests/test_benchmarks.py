# SPDX-License-Identifier: Apache-2.0
"""Every benchmark and the demo can be imported: what they use of the packages is still there."""

from __future__ import annotations

import importlib
from collections.abc import Callable
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
PEERS = {"gymnasium"}
"""Of an environment of its own, imported at the top."""


def test_every_benchmark_and_the_demo_import(each: Callable[..., None]) -> None:
    found = [*ROOT.glob("benchmarks/**/*.py"), *ROOT.glob("demo/*.py")]
    modules = [path.relative_to(ROOT).with_suffix("") for path in found]

    def check(module: Path) -> None:
        try:
            importlib.import_module(".".join(module.parts))
        except ModuleNotFoundError as error:
            if error.name not in PEERS:
                raise

    each([module for module in modules if "test" not in module.parts], check)
