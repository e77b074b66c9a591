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
import re
import shutil
import subprocess
import sys
import tempfile
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import mutation
from compiling import CC, HERE, PRECISIONS, ROOT, SANITIZE, build

BOX = (
    "arming.h", "box.h", "differentiation.h", "force_law.h", "guard.h", "number.h", "protocol.h", "reference.h",
    "stream.h",
)  # fmt: skip
"""Parts whose every line and branch must be reached, and whose mutants must die."""
EQUIVALENT = {
    "arming.h: #define HYDRO_NEVER (-2e300)": "longer ago than anything, either way",
    "arming.h: hydro_time left = 1.0 - (time - arming->armed_at) * HYDRO_RECOVERY;": "the time of grace is 1 s",
    "arming.h: return arming->excess * (hydro_real)(left >= 0.0 ? left : 0.0);": "at 0 both branches are 0",
    "box.h: #define HYDRO_BURST_MAX (5 * HYDRO_FRAME_MAX)": "a buffer may be larger",
    "force_law.h: return drop <= HYDRO_R(0) ? -HYDRO_SQRT(-drop) : HYDRO_SQRT(drop);": "the root of 0 is 0",
    (
        "guard.h: if (signal->amplitude < HYDRO_R(0) || signal->amplitude > force_range && offset > force_range"
    ): "what is let through here is beyond the range in the sum of the next line too, and cannot overflow there",
    "number.h: return x <= HYDRO_R(0) ? -x : x;": "0 is -0",
    "number.h: return x <= y ? y : x;": "one of two that are equal",
    "number.h: return x <= low ? low : (x > high ? high : x);": "x is the limit",
    "number.h: return x < low ? low : (x >= high ? high : x);": "x is the limit",
    "number.h: if (x > 4503599627370496.0 || x <= -4503599627370496.0) {": "2^52 has no fraction",
    "number.h: if (x >= 4503599627370496.0 || x < -4503599627370496.0) {": "2^52 has no fraction",
    "number.h: if (x >= 4503599627370497.0 || x <= -4503599627370496.0) {": "2^52 has no fraction",
    "protocol.h: #define HYDRO_FRAME_MAX 130u": "a buffer may be larger",
    "protocol.h: uint8_t body[HYDRO_HEADER + 73 + 4];": "a buffer may be larger",
    "protocol.h: uint8_t body[HYDRO_HEADER + 109 + 4];": "a buffer may be larger",
    "protocol.h: (void)hydro_write_reals(at, law->rate, 5);": "the check sum is written over it",
    "protocol.h: uint8_t body[HYDRO_HEADER + 61 + 4];": "a buffer may be larger",
    "reference.h: /* reference->leaving.waveform = HYDRO_HOLD; */": "without an amplitude it is a hold",
    "reference.h: /* reference->leaving.amplitude = HYDRO_R(0); */": "a hold is its offset",
    "reference.h: if (part > 1.0) {": "at 1 the new one has all of it",
    "stream.h: stream->count = HYDRO_ENCODED_MAX + 2;": "too long, either way",
}
"""Mutants that change nothing that can be observed, by part and what the line becomes, and why."""


def unit(folder: Path) -> None:
    """The unit tests of the box and of the default filter in both precisions."""
    for name, words in PRECISIONS.items():
        for source in ("test_box.c", "test_filter.c"):
            program = folder / f"test_{name}"
            build(HERE / source, program, "-O2", *words)
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


def coverage(folder: Path, source: Path = HERE / "test_box.c") -> dict[str, Reached]:
    """What a test program reaches of the parts, by gcov: functions that nothing calls count, too.

    A branch counts as reached if it was taken at least once.
    """
    kept = ["-fkeep-static-functions", "-fkeep-inline-functions"]
    build(source, folder / "covered", "-O0", "--coverage", *kept, "-o", str(folder / "covered"))
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


SAMPLES = ("hold", "sine", "multisine", "smooth_step", "fade", "disarmed", "greeting")
"""Samples of a box that are counted: COMMAND in and STATE out; with `greeting` HELLO, DETAILS and LAW besides."""

PARTS = ("policy",)
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
    return 1 if found.get("mutants", {}).get("alive") or any(parts[part]["missed"] for part in BOX) else 0


def _all(folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """Every check that was asked for, said line by line; what came of it by name."""
    unit(folder)
    found: dict[str, Any] = {"hostile": hostile(folder, options.hostile)}
    found["coverage"] = {part: asdict(each) for part, each in sorted(coverage(folder).items())}
    for part, each in found["coverage"].items():
        missed = ", ".join(each["missed"]) or "none"
        print(f"{part}: {each['lines']} lines, {each['branches']} branches, missed: {missed}")
    if not options.no_mutants:
        found["mutants"] = asdict(tried := mutation.mutate(folder, BOX, mutation.passes_unit_tests, EQUIVALENT))
        counts = f"{tried.equivalent} alive that change nothing, {len(tried.alive)} alive"
        print(f"{tried.count} mutants, {counts}", *tried.alive, sep="\n  ")
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
