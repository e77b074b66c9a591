# SPDX-License-Identifier: Apache-2.0
"""Compiled models: kept, made again where damaged, and refused in a sentence."""

from __future__ import annotations

import ctypes
import os
import shutil
import sys
from functools import partial
from pathlib import Path
from tempfile import TemporaryDirectory

from hydro_sim.jit import LOG_VARIABLE
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


PR_CAPBSET_DROP, CAP_DAC_OVERRIDE = 24, 1
KERNEL = "from hydro_sim.jit import njit\n{imported}@njit\ndef {name}(): return {value}\n"


def test_an_edit_in_a_called_module_reaches_its_callers(tmp_path: Path) -> None:
    """With numba's own cache the second process prints 1 again: it looks at the caller's file only."""
    package, path = tmp_path / "hydro_toy", os.pathsep.join([str(tmp_path), *sys.path])
    package.mkdir()
    (package / "__init__.py").touch()
    outer = KERNEL.format(name="outer", imported="from hydro_toy import inner\nlater = inner.inner\n", value="later()")
    (package / "outer.py").write_text(outer)
    environment = {"NUMBA_CACHE_DIR": None, "PYTHONPATH": path, LOG_VARIABLE: str(tmp_path / "log")}
    for value, compiled in ((1, 2), (22, 4), (22, 4)):
        (package / "inner.py").write_text(KERNEL.format(name="inner", imported="", value=value))
        os.utime(package / "inner.py", (value, value))
        assert printed("from hydro_toy.outer import outer; print(outer())", **environment) == f"{value}\n"
        assert len((tmp_path / "log").read_text().splitlines()) == compiled


def test_where_no_cache_can_be_written_it_is_temporary_and_a_sentence_says_so() -> None:
    """In a checkout that another user made, without a home."""
    program = """import os
from hydro_sim.jit import copy_vector
copy_vector([0.0], [1.0])
print(os.environ["NUMBA_CACHE_DIR"], sum(len(files) for _, _, files in os.walk(os.environ["NUMBA_CACHE_DIR"])))"""
    with TemporaryDirectory() as checkout:
        (package := Path(checkout) / "hydro_sim").mkdir()
        (package / "__init__.py").touch()
        shutil.copy(Path(__file__).parents[1] / "hydro_sim" / "jit.py", package)
        for folder in (package, package.parent):
            folder.chmod(0o555)
        changed = {"HOME": "/proc", "PYTHONPATH": os.pathsep.join([checkout, *sys.path]), "PYTHONWARNINGS": "ignore"}
        unnamed = {
            name: value for name, value in os.environ.items() if name not in ("NUMBA_CACHE_DIR", "XDG_CACHE_HOME")
        }
        as_others = partial(ctypes.CDLL(None).prctl, PR_CAPBSET_DROP, CAP_DAC_OVERRIDE)  # root may write all the same
        done = ran(sys.executable, "-c", program, env=unnamed | changed, cwd="/", preexec_fn=as_others)
        package.parent.chmod(0o755)
    assert done.returncode == 0, done.stderr
    folder, files = done.stdout.split()
    assert files == "2" and not Path(folder).exists(), "index and code; removed at the end"
    assert "each start compiles for minutes" in done.stderr and done.stderr.count("\n") == 1
