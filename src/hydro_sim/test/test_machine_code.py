# SPDX-License-Identifier: Apache-2.0
"""Compiled models: kept, made again where damaged, and refused in a sentence."""

from __future__ import annotations

import os
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from hydro_sim.model import machine_code
from tests.checks import ran

SOURCE = "int answer(void) { return 42; }\n"


@pytest.fixture(autouse=True)
def apart(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Path]:
    monkeypatch.setenv("NUMBA_CACHE_DIR", str(tmp_path / "cache"))
    machine_code._machine.cache_clear()
    yield tmp_path / "cache" / "models"
    machine_code._machine.cache_clear()


def test_a_damaged_library_is_compiled_anew(apart: Path) -> None:
    """In another process: this one has the library in memory."""
    library = f"machine_code.cached_library('x', lambda: {SOURCE!r})"
    make = f"from hydro_sim.model import machine_code; print({library}.answer())"
    first = ran(sys.executable, "-c", make)
    (kept,) = apart.glob("*.so")
    kept.write_bytes(kept.read_bytes()[:100])
    again = ran(sys.executable, "-c", make)
    assert first.stdout == again.stdout == "42\n"


INNER = "from numba import njit\n@njit(cache=True)\ndef inner(): return {value}\n"
OUTER = "from numba import njit\nfrom toy.inner import inner\n@njit(cache=True)\ndef outer(): return inner()\n"
INIT = """from pathlib import Path
from hydro_sim.compiled import remove_stale_caches
remove_stale_caches(Path(__file__).parent)
"""


def made(package: Path, **sources: str) -> Path:
    package.mkdir(exist_ok=True)
    for name, text in sources.items():
        (package / f"{name}.py").write_text(text)
    return package


def test_an_edit_in_a_called_module_reaches_its_callers(tmp_path: Path) -> None:
    """Without `remove_stale_caches` the second process prints 1 again: numba looks at the caller's file only."""
    package = made(tmp_path / "toy", __init__=INIT, outer=OUTER)
    printed = []
    for value in (1, 22):
        made(package, inner=INNER.format(value=value))
        path = os.pathsep.join([str(tmp_path), *sys.path])
        environment = {key: text for key, text in os.environ.items() if key != "NUMBA_CACHE_DIR"} | {"PYTHONPATH": path}
        printed.append(
            int(ran(sys.executable, "-c", "from toy.outer import outer; print(outer())", env=environment).stdout)
        )
    assert printed == [1, 22]
