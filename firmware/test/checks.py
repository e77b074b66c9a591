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
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

HERE = Path(__file__).resolve().parent
ROOT = HERE.parent
GUARDED = ("arming.h", "guard.h")
"""Parts that are mutated."""
COVERED = (*GUARDED, "box.h", "differentiation.h", "force_law.h", "number.h", "protocol.h", "reference.h", "stream.h")
"""Parts whose every line and branch must be reached."""

CC = os.environ.get("CC", "gcc")
STRICT = ["-std=c99", "-ffp-contract=off", "-Wall", "-Wextra", "-Wconversion", "-Werror"]
SANITIZE = ["-O1", "-g", "-fsanitize=address,undefined,float-cast-overflow", "-fno-sanitize-recover=all"]
PRECISIONS = {"double": [], "single": ["-DHYDRO_SINGLE"]}

EQUIVALENT = {
    ("arming.h", "#define HYDRO_NEVER (-2e300)"): "longer ago than anything, either way",
    ("arming.h", "return arming->excess * (hydro_real)(left >= 0.0 ? left : 0.0);"): "at 0 both branches are 0",
    (
        "guard.h",
        "if (signal->amplitude < HYDRO_R(0) || signal->amplitude > force_range && offset > force_range",
    ): "what is let through here is beyond the range in the sum of the next line too, and cannot overflow there",
}
"""Mutants that change nothing that can be observed, by part and what the line becomes, and why."""


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


def hostile(folder: Path, count: int) -> dict[str, str]:
    """Hostile bytes in both precisions; what each run says of itself."""
    found = {}
    for name, words in PRECISIONS.items():
        program = folder / f"hostile_{name}"
        build(HERE / "hostile.c", program, *SANITIZE, *words)
        done = subprocess.run([str(program), str(count)], check=True, capture_output=True, text=True)
        found[name] = done.stdout.strip()
        print(f"hostile bytes, {name}: {found[name]}")
    return found


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


@dataclass(frozen=True)
class Mutant:
    """One change of one line: its number, what was changed, what the line's code becomes, and the whole text."""

    line: int
    change: str
    becomes: str
    text: str


def mutants(text: str) -> Iterator[Mutant]:
    """Each single change of the code."""
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
            change = f"{code[start:end].strip()} -> {new.strip()}"
            yield Mutant(index + 1, change, made.strip(), "\n".join([*lines[:index], made, *lines[index + 1 :]]))
        if STATEMENT.match(code.rstrip()):
            yield Mutant(index + 1, "statement removed", "", "\n".join([*lines[:index], "", *lines[index + 1 :]]))


@dataclass
class Mutation:
    """How many mutants there were, which live unexplained, and how many live for a reason in `EQUIVALENT`."""

    count: int
    alive: list[str]
    equivalent: int


def mutate(folder: Path) -> Mutation:
    """Every mutant of the guarded parts against the unit tests; an explanation that no mutant needs is alive too."""
    copy, count, alive, explained = folder / "mutant", 0, [], set()
    shutil.copytree(ROOT, copy)
    program, source = folder / "mutated", copy / "test" / "test_box.c"
    for name in GUARDED:
        path, text = copy / "hydro" / name, (ROOT / "hydro" / name).read_text()
        for mutant in mutants(text):
            path.write_text(mutant.text)
            command = [CC, "-std=c99", "-O0", "-w", str(source), "-o", str(program), "-lm"]
            if subprocess.run(command, capture_output=True, check=False).returncode:
                continue  # no program: not a mutant
            count += 1
            if _dies(program):
                continue
            if (name, mutant.becomes) in EQUIVALENT:
                explained.add((name, mutant.becomes))
            else:
                alive.append(f"{name}:{mutant.line} {mutant.change}")
        path.write_text(text)
    alive += [f"{name}: no mutant lives as {becomes!r}" for name, becomes in EQUIVALENT.keys() - explained]
    return Mutation(count, alive, len(explained))


def _dies(program: Path) -> bool:
    try:
        return subprocess.run([str(program)], capture_output=True, check=False, timeout=20).returncode != 0
    except subprocess.TimeoutExpired:
        return True


SAMPLES = ("hold", "sine", "multisine", "smooth_step", "fade", "disarmed", "greeting")
"""Samples of a box that are counted: COMMAND in and STATE out; with `greeting` HELLO and DETAILS besides."""

PARTS = ("filter", "loop_filter", "policy")
"""Optional parts, of which one decision is counted."""


def operations(folder: Path) -> dict[str, dict[str, int]]:
    """Instructions of one sample by precision and kind, by callgrind: two runs that differ by 1000 samples."""
    found: dict[str, dict[str, int]] = {}
    for precision, words in PRECISIONS.items():
        program = folder / f"operations_{precision}"
        build(HERE / "operations.c", program, "-O2", *words)
        found[precision] = {}
        host = _difference(folder, program, "host")
        found[precision] |= {kind: _difference(folder, program, kind) - host for kind in SAMPLES}
        found[precision] |= {kind: _difference(folder, program, kind) for kind in PARTS}
    return found


def _difference(folder: Path, program: Path, kind: str) -> int:
    few, many = (_instructions(folder, program, kind, samples) for samples in (1000, 2000))
    return round((many - few) / 1000)


def sizes(folder: Path) -> dict[str, dict[str, int]]:
    """Bytes by precision: code and constants of the whole box for size, without the mathematics library; one box."""
    found = {}
    for precision, words in PRECISIONS.items():
        whole, program = folder / f"box_{precision}.o", folder / f"sizes_{precision}"
        build(ROOT / "hydro_box.c", whole, "-Os", "-c", *words)
        done = subprocess.run(["size", str(whole)], check=True, capture_output=True, text=True)
        build(HERE / "operations.c", program, "-O2", *words)
        box = subprocess.run([str(program), "size", "0"], check=True, capture_output=True, text=True)
        found[precision] = {"code": int(done.stdout.split("\n")[1].split()[0]), "box": int(box.stdout)}
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
    parser.add_argument("--json", type=Path, metavar="FILE", help="write what was found there too")
    options = parser.parse_args()
    needed = [CC, "gcov", "size"] + (["valgrind"] if not options.no_operations else [])
    if missing := [tool for tool in needed if shutil.which(tool) is None]:
        hint = "; --no-operations leaves out what needs valgrind" if "valgrind" in missing else ""
        print(f"not found: {', '.join(missing)}{hint}", file=sys.stderr)
        return 2
    try:
        with tempfile.TemporaryDirectory() as name:
            found = _all(Path(name), options)
    except subprocess.CalledProcessError as error:
        said = error.stderr.decode() if isinstance(error.stderr, bytes) else error.stderr or ""
        print(f"failed with status {error.returncode}: {' '.join(error.cmd)}\n{said}".rstrip(), file=sys.stderr)
        return 1
    if options.json:
        options.json.write_text(json.dumps(found, indent=1) + "\n")
    parts = found["coverage"]
    return 1 if found.get("mutants", {}).get("alive") or any(parts[part]["missed"] for part in COVERED) else 0


def _all(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Every check that was asked for, said line by line; what came of it by name."""
    unit(folder)
    found: dict[str, Any] = {"hostile": hostile(folder, options.hostile)}
    found["coverage"] = {part: asdict(each) for part, each in sorted(coverage(folder).items())}
    for part, each in found["coverage"].items():
        missed = ", ".join(each["missed"]) or "none"
        print(f"{part}: {each['lines']} lines, {each['branches']} branches, missed: {missed}")
    if not options.no_mutants:
        found["mutants"] = asdict(mutation := mutate(folder))
        counts = f"{mutation.equivalent} alive that change nothing, {len(mutation.alive)} alive"
        print(f"{mutation.count} mutants, {counts}", *mutation.alive, sep="\n  ")
    found["bytes"] = sizes(folder)
    for precision, parts in found["bytes"].items():
        print(f"{precision}: {parts['code']} bytes of code, {parts['box']} bytes a box")
    if not options.no_operations:
        found["instructions"] = operations(folder)
        for precision, kinds in found["instructions"].items():
            for kind, instructions in kinds.items():
                print(f"{precision}, {kind}: {instructions} instructions")
    return found


if __name__ == "__main__":
    sys.exit(main())
