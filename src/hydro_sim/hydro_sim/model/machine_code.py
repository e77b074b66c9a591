# SPDX-License-Identifier: Apache-2.0
"""Compiled C libraries, cached by the digest of their source, and calls to them from numba.

Libraries are cached as numba's are: next to the sources, or in NUMBA_CACHE_DIR; where neither can be written, below
~/.cache. `make setup` compiles the usual ones; any other set of effects is compiled at first use, and a message says
so.
"""

from __future__ import annotations

import ctypes
import fcntl
import hashlib
import os
import platform
import shlex
import shutil
import subprocess
import tempfile
from collections.abc import Callable, Sequence
from functools import cache
from pathlib import Path
from typing import Any

from llvmlite import ir
from numba import types
from numba.extending import intrinsic

COMPILER_FLAGS = (
    "-std=c11", "-O3", "-march=native", "-fPIC", "-shared", "-fno-math-errno", "-fno-trapping-math",
    "-ffp-contract=fast",
)  # fmt: skip
"""Compiler flags: sums keep their order; a product and a sum may be rounded once."""


def cached_library(name: str, source: Callable[[], str]) -> ctypes.CDLL:
    """Return the cached library of a specification; compiles the C of `source()` if missing.

    `name`: specification of the source as text: all that it depends on. Raises ValueError: there is no C compiler, it
    fails, or there is no place to keep the library.
    """
    named = os.environ.get("NUMBA_CACHE_DIR")
    folder = Path(named) if named else Path(__file__).resolve().parent / "__pycache__"
    if not os.access(folder if folder.exists() else folder.parent, os.W_OK):
        folder = Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "hydro"
    file = folder / "models" / f"{hashlib.sha256(f'{name} {_machine()}'.encode()).hexdigest()[:24]}.so"
    if found := _loaded(file):
        return found
    try:
        file.parent.mkdir(parents=True, exist_ok=True)
        with (file.parent / "lock").open("w") as lock:  # a graph starts its nodes at once
            fcntl.flock(lock, fcntl.LOCK_EX)
            if found := _loaded(file):
                return found
            with tempfile.TemporaryDirectory(dir=file.parent) as place:
                library = Path(place) / "model.so"
                compile_c(source(), library)
                library.with_suffix(".c").replace(file.with_suffix(".c"))
                library.replace(file)
    except OSError as error:
        where = f"{file.parent} ({error.strerror})"
        raise ValueError(f"compiled models cannot be kept in {where}: set NUMBA_CACHE_DIR to a folder") from error
    if found := _loaded(file):
        return found
    raise ValueError(f"{file} was compiled and cannot be loaded: set NUMBA_CACHE_DIR to a folder that allows programs")


def _loaded(file: Path) -> ctypes.CDLL | None:
    """None where it is not there, or damaged: a disk was full, or it was copied in part."""
    try:
        return ctypes.CDLL(str(file)) if file.exists() else None
    except OSError:
        return None


def compile_c(source: str, library: Path, flags: Sequence[str] = COMPILER_FLAGS) -> None:
    """Write C source next to `library`, and compile it. Raises ValueError: no C compiler, or it fails."""
    compiler = shlex.split(os.environ.get("CC", "")) or [*filter(shutil.which, ("cc", "gcc", "clang"))][:1]
    if not compiler or shutil.which(compiler[0]) is None:
        raise ValueError("no C compiler found for the model of this bench: `apt install gcc`")
    text = library.with_suffix(".c")
    text.write_text(source, encoding="utf-8")
    words = [*compiler, *flags, str(text), "-o", str(library), "-lm"]
    done = subprocess.run(words, capture_output=True, text=True, check=False)
    if done.returncode:
        first = next((line for line in done.stderr.splitlines() if "error" in line), "no message")
        raise ValueError(f"the C compiler refuses the model of this bench: {first}")


@cache
def _machine() -> str:
    try:
        first = Path("/proc/cpuinfo").read_text().partition("\n\n")[0].splitlines()
    except OSError:
        first = [platform.processor()]
    features = [line for line in first if line.startswith(("model name", "flags", "Features"))]
    return " ".join([platform.machine(), os.environ.get("CC", ""), *COMPILER_FLAGS, *features])


def declare_call(signature: Any, letters: str) -> Any:
    """Declare a call by address for numba; `letters`: kind of each argument, array (p), float (d) or int (l)."""
    kinds = {"p": ir.IntType(8).as_pointer(), "d": ir.DoubleType(), "l": ir.IntType(64)}

    def code(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        at, *given = arguments
        for i, (kind, letter) in enumerate(zip(signature.args[1:], letters, strict=True)):
            if letter == "p":
                given[i] = builder.bitcast(context.make_array(kind)(context, builder, given[i]).data, kinds["p"])
        function = ir.FunctionType(ir.VoidType(), [kinds[letter] for letter in letters])
        builder.call(builder.inttoptr(at, function.as_pointer()), given)
        return context.get_dummy_value()

    return signature, code


@intrinsic
def sample(typingctx: Any, address: Any, k: Any, y: Any, current: Any, z: Any) -> Any:
    """Call `bench_sample` at an address: y, in place, and readings z after a sample at a current [A]. For numba."""
    return declare_call(types.void(types.int64, k, y, types.float64, z), "ppdp")
