# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

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
        command = [sys.executable, "-c", "from toy.outer import outer; print(outer())"]
        printed.append(int(subprocess.run(command, env=environment, check=True, capture_output=True, text=True).stdout))
    assert printed == [1, 22]
