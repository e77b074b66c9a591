# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import os
import subprocess
import sys
from pathlib import Path

from hydro_sim.compiled import remove_stale_caches

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


def test_only_what_imports_an_edited_source_is_forgotten(tmp_path: Path) -> None:
    package = made(tmp_path / "toy", __init__="", inner=INNER.format(value=1), outer=OUTER, plain="", other=INNER)
    caches = [package / "__pycache__" / f"{name}.inner-1.py311.nbi" for name in ("inner", "outer", "other")]

    def left(**edited: str) -> list[bool]:
        caches[0].parent.mkdir(exist_ok=True)
        for cache in caches:
            cache.touch()
        made(package, **edited)
        changed = remove_stale_caches(package)
        assert changed or not edited
        return [cache.exists() for cache in caches]

    assert left(plain="a = 1") == [False, False, False], "nothing is known yet of what there is"
    assert left() == [True, True, True]
    assert left(plain="b = 22") == [True, True, True]
    assert left(inner=INNER.format(value=333)) == [False, False, True]
    assert left(new="from numba import njit") == [True, True, True]
    assert left(__init__="c = 4444") == [True, True, True], "nothing is imported from there"
    assert left(outer=OUTER + "from toy import c") == [True, False, True]
    assert left(__init__="c = 55555") == [True, False, True]


def test_sources_of_another_package_count(tmp_path: Path) -> None:
    below = made(tmp_path / "below", __init__="", constants="A = 1")
    above = made(tmp_path / "above", __init__="", kernel="from numba import njit\nfrom below.constants import A\n")
    remove_stale_caches(above, below)
    cache = above / "__pycache__" / "kernel.f-1.py311.nbi"
    cache.touch()
    made(below, constants="A = 22")
    assert remove_stale_caches(above, below) and not cache.exists()
    assert not remove_stale_caches(above, below)
