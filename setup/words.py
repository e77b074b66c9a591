# SPDX-License-Identifier: Apache-2.0
"""Names in the field's words: `python -m setup.words` refuses those that have a standard term (`make lint`)."""

from __future__ import annotations

import ast
import sys
from collections.abc import Iterator
from pathlib import Path

ROOT = Path(__file__).resolve().parent.parent
STANDARD = {
    "abandoned_after": "gains_timeout",
    "box_header": "export",
    "filter_header": "export_c",
    "Findings": "ReportMarks",
    "flag_words": "flag_labels",
    "last_words": "last_line",
    "level_back": "level_vjp",
    "listen_to_box": "subscribe_to_box",
    "memory_size": "nbytes",
    "PolicyKeeper": "RunState",
    "policy_header": "export_c",
    "untold": "unexplained",
}
"""Standard term of each word that was in use here once."""
EXCEPTIONS = {
    ("benchmarks/_sac_learners.py", "memory_size"): "an argument of skrl",
    ("tests/test_firmware_parts.py", "policy_header"): "the module",
}
"""File and word, and why it stays."""


def names(tree: ast.AST) -> Iterator[tuple[int, str]]:
    """Yield line and name of all that a module defines, takes, assigns or calls."""
    for node in ast.walk(tree):
        for field in ("id", "attr", "name", "arg", "asname"):
            if isinstance(name := getattr(node, field, None), str):
                yield getattr(node, "lineno", 0), name


def main() -> int:
    """Print every refused name; the exit status is 1 if there is one."""
    found = [
        f"{file}:{line}: {name} is {STANDARD[name]} here"
        for folder in ("src", "benchmarks", "tests", "setup", "docs", "demo")
        for path in sorted((ROOT / folder).rglob("*.py"))
        if (file := str(path.relative_to(ROOT)))
        for line, name in sorted(set(names(ast.parse(path.read_text(encoding="utf-8")))))
        if name in STANDARD and (file, name) not in EXCEPTIONS
    ]
    print("\n".join(found), end="\n" if found else "")
    return int(bool(found))


if __name__ == "__main__":
    sys.exit(main())
