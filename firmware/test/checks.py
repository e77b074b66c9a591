# SPDX-License-Identifier: Apache-2.0
"""Checks of the box in C: `make firmware`, or python firmware/test/checks.py.

Unit tests in double and single precision; hostile bytes under the address and undefined-behaviour sanitizers with
floating-point exceptions on; coverage of lines and branches by gcov; mutants; instructions per sample by callgrind.
Ends with status 1 where one fails, where a line or branch of the guarded parts is not reached, or a mutant lives that
`EQUIVALENT` does not explain.
"""

from __future__ import annotations

import argparse
import json
import os
import re
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
GUARDED = ("arming.h", "guard.h")
"""Parts whose every line and branch must be reached, and that are mutated."""

CC = os.environ.get("CC", "gcc")
STRICT = ["-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
SANITIZE = ["-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
PRECISIONS = {"double": [], "single": ["-DHYDRO_SINGLE"]}

EQUIVALENT = {
    "-1e300 -> -2e300": "longer ago than anything, either way",
}
"""Mutants that change nothing that can be observed, and why."""


def build(source: Path, program: Path, *words: str) -> None:
    """Compile one program."""
    subprocess.run([CC, *STRICT, *words, str(source), "-o", str(program), "-lm"], check=True)


def unit(folder: Path) -> None:
    """The unit tests in both precisions."""
    for name, words in PRECISIONS.items():
        program = folder / f"test_{name}"
        build(HERE / "test_box.c", program, "-O2", *words)
        subprocess.run([str(program)], check=True)
        print(f"unit tests, {name}: pass")


def hostile(folder: Path, count: int) -> None:
    """Hostile bytes in both precisions."""
    for name, words in PRECISIONS.items():
        program = folder / f"hostile_{name}"
        build(HERE / "hostile.c", program, *SANITIZE, *words)
        done = subprocess.run([str(program), str(count)], check=True, capture_output=True, text=True)
        print(f"hostile bytes, {name}: {done.stdout.strip()}")


@dataclass(frozen=True)
class Reached:
    """Lines and branches of one part: how many there are, and which were not reached."""

    lines: int
    branches: int
    missed: tuple[str, ...]


def coverage(folder: Path) -> dict[str, Reached]:
    """What the unit tests reach, by gcov; a branch counts if it was taken at least once."""
    build(HERE / "test_box.c", folder / "covered", "-O0", "--coverage", "-o", str(folder / "covered"))
    subprocess.run([str(folder / "covered")], check=True, cwd=folder)
    data = next(folder.glob("*.gcda"))
    done = subprocess.run(
        ["gcov", "--branch-probabilities", "--json-format", "--stdout", str(data)],
        check=True, capture_output=True, cwd=folder,
    )  # fmt: skip
    found = {}
    for file in json.loads(done.stdout)["files"]:
        name = Path(file["file"]).name
        if Path(file["file"]).parent.name != "hydro":
            continue
        lines = file["lines"]
        branches = [(line["line_number"], branch) for line in lines for branch in line["branches"]]
        missed = [f"{name}:{line['line_number']}" for line in lines if not line["count"]]
        missed += [f"{name}:{number} a branch" for number, branch in branches if not branch["count"]]
        found[name] = Reached(len(lines), len(branches), tuple(missed))
    return found


REPLACED = (
    (r"(?<![<>=!-])<(?![<=])", ("<=", ">=")),
    (r"(?<![<>=!-])>(?![>=])", (">=", "<=")),
    (r"<=", ("<",)),
    (r">=", (">",)),
    (r"==", ("!=",)),
    (r"!=", ("==",)),
    (r"&&", ("||",)),
    (r"\|\|", ("&&",)),
    (r" \+ ", (" - ",)),
    (r" - ", (" + ",)),
    (r"\|=", ("=", "&=")),
    (r"\btrue\b", ("false",)),
    (r"\bfalse\b", ("true",)),
    (r"!(?=[a-z])", ("",)),
    (r"\+\+", ("--",)),
    (r"-1e300", ("-2e300",)),
)
STATEMENT = re.compile(r"^\s+[a-z][\w>.\[\]-]*( [|+-]?= .*|\+\+);$")


def mutants(text: str) -> Iterator[tuple[int, str, str]]:
    """Line number, what was changed, and the whole text with the change: each single change of the code."""
    lines = text.split("\n")
    begin = next(index for index, line in enumerate(lines) if line.startswith("static inline"))
    for index, line in enumerate(lines):
        code = line.split("/*")[0]
        if (index < begin and "define HYDRO_" not in line) or line.lstrip().startswith(("*", "/*")):
            continue
        changes = [
            (match.start(), match.end(), new)
            for pattern, news in REPLACED
            for match in re.finditer(pattern, code)
            for new in news
        ]
        changes += [
            (match.start(), match.end(), new)
            for match in re.finditer(r"(?<![\w.-])\d+(\.\d+)?(?=[,;()\s]|u\b|$)", code)
            for new in (str(float(match[0]) + 1.0) if "." in match[0] else str(int(match[0]) + 1),)
        ]
        for start, end, new in changes:
            made = code[:start] + new + code[end:]
            yield (
                index + 1,
                f"{code[start:end].strip()} -> {new.strip()}",
                "\n".join([*lines[:index], made, *lines[index + 1 :]]),
            )
        if STATEMENT.match(code.rstrip()):
            yield index + 1, "statement removed", "\n".join([*lines[:index], "", *lines[index + 1 :]])


def mutate(folder: Path) -> tuple[int, list[str]]:
    """How many mutants there are, and which live."""
    copy, count, alive = folder / "mutant", 0, []
    shutil.copytree(ROOT, copy)
    program, source = folder / "mutated", copy / "test" / "test_box.c"
    for name in GUARDED:
        path, text = copy / "hydro" / name, (ROOT / "hydro" / name).read_text()
        for number, change, mutant in mutants(text):
            path.write_text(mutant)
            command = [CC, "-std=c99", "-O0", "-w", str(source), "-o", str(program), "-lm"]
            if subprocess.run(command, capture_output=True, check=False).returncode:
                continue  # no program: not a mutant
            count += 1
            if not _dies(program) and change not in EQUIVALENT:
                alive.append(f"{name}:{number} {change}")
        path.write_text(text)
    return count, alive


def _dies(program: Path) -> bool:
    try:
        return subprocess.run([str(program)], capture_output=True, check=False, timeout=20).returncode != 0
    except subprocess.TimeoutExpired:
        return True


def operations(folder: Path) -> dict[str, int]:
    """Instructions of one sample, by callgrind: the difference of two runs that differ by 1000 samples."""
    program = folder / "operations"
    build(HERE / "operations.c", program, "-O2")
    found = {}
    for kind in ("hold", "sine", "multisine", "smooth_step", "fade", "disarmed"):
        few, many = (_instructions(folder, program, kind, samples) for samples in (1000, 2000))
        found[kind] = round((many - few) / 1000)
    return found


def _instructions(folder: Path, program: Path, kind: str, samples: int) -> int:
    words = ["valgrind", "--tool=callgrind", f"--callgrind-out-file={folder / 'callgrind'}", str(program), kind]
    done = subprocess.run([*words, str(samples)], check=True, capture_output=True, text=True)
    return int(re.search(r"Collected : (\d+)", done.stderr)[1])  # type: ignore[index]


def main() -> int:
    """Entry point."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--hostile", type=int, default=10_000_000, help="bytes (default: %(default)s)")
    parser.add_argument("--no-mutants", action="store_true", help="leave out what takes minutes")
    parser.add_argument("--no-operations", action="store_true", help="leave out what needs valgrind")
    options = parser.parse_args()
    with tempfile.TemporaryDirectory() as name:
        folder, alive = Path(name), []
        unit(folder)
        hostile(folder, options.hostile)
        reached = coverage(folder)
        for part, found in sorted(reached.items()):
            print(
                f"{part}: {found.lines} lines, {found.branches} branches, missed: {', '.join(found.missed) or 'none'}"
            )
        if not options.no_mutants:
            count, alive = mutate(folder)
            print(f"{count} mutants, {len(alive)} alive", *alive, sep="\n  ")
        if not options.no_operations:
            for kind, instructions in operations(folder).items():
                print(f"{kind}: {instructions} instructions a sample, COMMAND in and STATE out included")
    return 1 if alive or any(reached[part].missed for part in GUARDED) else 0


if __name__ == "__main__":
    sys.exit(main())
