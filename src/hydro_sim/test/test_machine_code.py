# SPDX-License-Identifier: Apache-2.0
"""Compiled models: kept, made again where damaged, and refused in a sentence."""

from __future__ import annotations

import os
import sys
from pathlib import Path

from tests.checks import ran


def printed(program: str, **changed: str | None) -> str:
    """What a process prints; each has its own memory of what was compiled. `changed`: of the environment."""
    environment = {name: value for name, value in {**os.environ, **changed}.items() if value is not None}
    return ran(sys.executable, "-c", program, env=environment).stdout


def test_a_damaged_library_is_compiled_anew(tmp_path: Path) -> None:
    source = "int answer(void) { return 42; }\n"
    library = f"machine_code.cached_library('x', lambda: {source!r})"
    program = f"from hydro_sim.model import machine_code; print({library}.answer())"
    assert printed(program, NUMBA_CACHE_DIR=str(tmp_path)) == "42\n"
    (kept,) = tmp_path.glob("models/*.so")
    kept.write_bytes(kept.read_bytes()[:100])
    assert printed(program, NUMBA_CACHE_DIR=str(tmp_path)) == "42\n"


INNER = "from numba import njit\n@njit(cache=True)\ndef inner(): return {value}\n"
OUTER = "from numba import njit\nfrom toy.inner import inner\n@njit(cache=True)\ndef outer(): return inner()\n"
INIT = """from pathlib import Path
from hydro_sim.compiled import remove_stale_caches
remove_stale_caches(Path(__file__).parent)
"""


def test_an_edit_in_a_called_module_reaches_its_callers(tmp_path: Path) -> None:
    """Without `remove_stale_caches` the second process prints 1 again: numba looks at the caller's file only."""
    package, path = tmp_path / "toy", os.pathsep.join([str(tmp_path), *sys.path])
    package.mkdir()
    (package / "__init__.py").write_text(INIT)
    (package / "outer.py").write_text(OUTER)
    for value in (1, 22):
        (package / "inner.py").write_text(INNER.format(value=value))
        program = "from toy.outer import outer; print(outer())"
        assert printed(program, NUMBA_CACHE_DIR=None, PYTHONPATH=path) == f"{value}\n"
