# SPDX-License-Identifier: Apache-2.0
"""`python -m benchmarks.prove.blind CASE...`: diagnoses cases from recordings and bench.yaml alone.

Each CASE is a folder of recordings beside bench.yaml, and gets answer.json and corrected.yaml. Finished cases are left
alone; several can run side by side.

An audit hook (PEP 578) refuses the other files of the proof, listings of folders, other processes but the compiler of
a bench's model, and the code of the truth plant. It guards against a mistake, not against native code written to get
around it.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import sys
import time
from hashlib import sha256
from pathlib import Path
from types import FrameType
from typing import Any

import hydro_diagnosis
import hydro_sim.model
from benchmarks.prove.cases import FITTED, HELD, missing
from hydro_core.cli.console import command
from hydro_core.files.atomic import write_atomic
from hydro_diagnosis import InputError, diagnose, jobs
from hydro_diagnosis.report.corrected_bench import write_corrected
from hydro_sim.model.machine_code import COMPILER_FLAGS

_packages = (Path(hydro_diagnosis.__file__).parent, Path(hydro_sim.model.__file__).parent)
_sources = (path.read_bytes() for package in _packages for path in sorted(package.rglob("*.py")))
ENGINE = sha256(b"".join(_sources)).hexdigest()[:12]
"""Digest of the sources that this process has loaded: computed at import, so that later edits do not count."""
TRUTH = "hydro_sim.emulator"
"""Package whose code makes the recordings."""
_STARTS = ("subprocess.Popen", "os.exec", "os.posix_spawn", "os.system", "os.fork")


class SealedError(PermissionError):
    """The diagnosis reached for what it must not see."""


_worn: set[tuple[str, str]] = set()


def guard(hidden: Path, seen: Path) -> None:
    """Refuse access below `hidden` except below `seen`; one call per process and pair of folders suffices."""
    pair = (os.path.realpath(hidden), os.path.realpath(seen))
    if pair in _worn:
        return
    _worn.add(pair)
    if any(name == TRUTH or name.startswith(TRUTH + ".") for name in sys.modules):
        raise SealedError(f"{TRUTH} is loaded already")

    def look(event: str, arguments: tuple[Any, ...]) -> None:
        if event in ("open", "os.listdir", "os.scandir"):
            path = arguments[0] if arguments else None
            if isinstance(path, (str, bytes, os.PathLike)):
                real = Path(os.path.realpath(os.fsdecode(path)))
                if real.is_relative_to(pair[0]) and not real.is_relative_to(pair[1]):
                    raise SealedError(f"{os.fsdecode(path)} is sealed")
        elif event == "import" and str(arguments[0]).startswith(TRUTH):
            raise SealedError(f"{arguments[0]} holds the truth")
        elif event in _STARTS:
            words = list(arguments[1]) if event == "subprocess.Popen" else []
            # flags of `machine_code`, which compiles for the forecast
            if words[1 : 1 + len(COMPILER_FLAGS)] != list(COMPILER_FLAGS):
                raise SealedError("the diagnosis starts no other process")

    sys.addaudithook(look)


ANSWER = "answer.json"
LIMIT = 300
"""s of CPU after which a case counts as refused."""


def diagnosed(case: Path) -> None:
    """Diagnose one case and write its answer.json: report, refused (a sentence or null), wall and cpu [s], engine."""
    if answered(case):  # another one was here in the meantime
        return
    guard(case.parent.parent, case.parent)
    begun, cpu = time.monotonic(), time.process_time()
    answer: dict[str, Any] = {"report": None, "refused": None, "engine": ENGINE}
    signal.signal(signal.SIGPROF, _too_long)
    signal.setitimer(signal.ITIMER_PROF, LIMIT)
    try:
        found = diagnose([case / name for name in FITTED], holdout=[case / HELD], bench=case.parent / "bench.yaml")
        answer["report"] = json.loads(found.report.to_json())
        write_corrected(found.bench, found.assessment.fit.claims, case / "corrected.yaml")
    except InputError as error:
        answer["refused"] = str(error)
    finally:
        signal.setitimer(signal.ITIMER_PROF, 0.0)
    answer |= {"wall": time.monotonic() - begun, "cpu": time.process_time() - cpu}
    write_atomic(case / ANSWER, json.dumps(answer, indent=1).encode())


def _too_long(number: int, frame: FrameType | None) -> None:
    raise InputError(f"no answer after {LIMIT} s of CPU")


def answered(case: Path) -> bool:
    """Whether this version of the diagnosis has answered a case."""
    answer = case / ANSWER
    return answer.exists() and bool(json.loads(answer.read_text())["engine"] == ENGINE)


def waiting(folder: Path) -> list[Path]:
    """Cases whose recordings are whole and that this version has not answered yet."""
    return [case for case in sorted(folder.glob("case-*")) if not answered(case) and not missing(case)]


@command(OSError)
def main() -> None:
    """Entry point: one after the other."""
    options = argparse.ArgumentParser(prog="blind", description=__doc__)
    options.add_argument("cases", nargs="+", type=Path, metavar="CASE")
    chosen = options.parse_args(sys.argv[1:]).cases
    jobs.run_all(diagnosed, {case.name: (case,) for case in chosen}, processes=1)


if __name__ == "__main__":
    main()
