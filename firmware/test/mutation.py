# SPDX-License-Identifier: Apache-2.0
"""Mutants of the box in C: each single change of a part's code, and whether the tests see it."""

from __future__ import annotations

import re
import shutil
import subprocess
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

from compiling import CC, PRECISIONS, ROOT, SANITIZE

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
    (r" \* ", (" / ",)),
    (r" / ", (" * ",)),
    (r"(?<=[=(:?] )-(?=[a-zH])", ("",)),
    (r"\|=", ("=", "&=")),
    (r"\btrue\b", ("false",)),
    (r"\bfalse\b", ("true",)),
    (r"!(?=[a-z])", ("",)),
    (r"\+\+", ("--",)),
    (r"-1e300", ("-2e300",)),
)
STATEMENT = re.compile(r"^\s+[a-z][\w>.\[\]-]*( [|+-]?= .*|\+\+);$")
NUMBER = re.compile(r"(?<![\w.-])\d+(\.\d+)?(?=[,;()\s]|u\b|$)")


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
        changes += [(match.start(), match.end(), _more(match[0])) for match in NUMBER.finditer(code)]
        for start, end, new in changes:
            made = code[:start] + new + code[end:]
            change = f"{code[start:end].strip()} -> {new.strip()}"
            yield Mutant(index + 1, change, made.strip(), "\n".join([*lines[:index], made, *lines[index + 1 :]]))
        if STATEMENT.match(code.rstrip()):
            yield Mutant(
                index + 1, "removed", f"/* {code.strip()} */", "\n".join([*lines[:index], "", *lines[index + 1 :]])
            )


def _more(number: str) -> str:
    return str(float(number) + 1.0) if "." in number else str(int(number) + 1)


@dataclass
class Mutation:
    """How many mutants there were, which live unexplained, and how many live for a reason that was given."""

    count: int
    alive: list[str]
    equivalent: int


def mutate(
    folder: Path, parts: Iterable[str], lives: Callable[[Path], bool | None], explained: dict[str, str]
) -> Mutation:
    """Every mutant of some parts, each in a copy of `firmware/`.

    Parameters
    ----------
    folder
        Where the copy is made.
    parts
        Names of headers below `hydro/`.
    lives
        Whether the tests of a copy pass; None where it does not compile, and is no mutant.
    explained
        Why a mutant that lives changes nothing, by "part: what the line becomes". A reason that no mutant needs is
        counted among those that live.
    """
    copy, count, alive, needed = folder / "mutant", 0, [], set()
    shutil.copytree(ROOT, copy, dirs_exist_ok=True)
    for name in parts:
        path, text = copy / "hydro" / name, (ROOT / "hydro" / name).read_text()
        for mutant in mutants(text):
            path.write_text(mutant.text)
            living = lives(copy)
            count += living is not None
            if not living:
                continue
            label = f"{name}: {mutant.becomes}"
            needed.add(label)
            if label not in explained:
                alive.append(f"{name}:{mutant.line} {mutant.change} | {label}")
        path.write_text(text)
    alive += [f"no mutant lives as {label!r}" for label in explained.keys() - needed]
    return Mutation(count, alive, len(needed & explained.keys()))


def passes_unit_tests(firmware: Path) -> bool | None:
    """Whether the unit tests pass in both precisions and under the sanitizers; None where they do not compile."""
    return passes(firmware / "test" / "test_box.c", firmware / "mutated", *PRECISIONS.values(), SANITIZE)


def passes(source: Path, program: Path, *variants: list[str]) -> bool | None:
    """Whether a test program ends with 0 as each variant; None where one does not compile."""
    for words in variants:
        command = [CC, "-std=c99", "-O0", "-w", "-ffp-contract=off", *words, str(source), "-o", str(program), "-lm"]
        if subprocess.run(command, capture_output=True, check=False).returncode:
            return None
        try:
            if subprocess.run([str(program)], capture_output=True, check=False, timeout=20).returncode:
                return False
        except subprocess.TimeoutExpired:
            return False
    return True
