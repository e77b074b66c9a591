# SPDX-License-Identifier: Apache-2.0
"""The chamber equations are written once: `hydro_sim.model.equations`. Derivatives in other files are generated."""

from __future__ import annotations

import ast
from pathlib import Path

import pytest

SOURCES = Path(__file__).parents[1] / "src"
EQUATIONS = SOURCES / "hydro_sim/hydro_sim/model/equations.py"
INDEPENDENT = ("hydro_sim/hydro_sim/emulator/", "hydro_bridge/hydro_bridge/conformance/law.py")
"""On purpose: the emulator's truth, and what checks a box."""
GENERATED = ("hydro_sim/hydro_sim/structured/derivatives.py", "hydro_filter/hydro_filter/model/analytic_kernels.py")
DEAD_VOLUMES = ("dead_volume_a", "dead_volume_b", "DEAD_A", "DEAD_B")
MODULI = ("bulk_modulus", "BULK", "modulus", "moduli")


def name(node: ast.expr) -> str:
    """Last name of an operand: x, n.x, c[X], x[0]."""
    if isinstance(node, ast.Subscript):
        return name(node.slice) or name(node.value)
    if isinstance(node, ast.Constant):
        return node.value if isinstance(node.value, str) else ""
    return node.attr if isinstance(node, ast.Attribute) else node.id if isinstance(node, ast.Name) else ""


def writings(text: str) -> list[int]:
    """Lines with a chamber's volume (dead volume + area x travel) or its stiffness (modulus / volume)."""
    found = []
    for node in ast.walk(ast.parse(text)):
        if not isinstance(node, ast.BinOp):
            continue
        volume = isinstance(node.op, ast.Add) and name(node.left) in DEAD_VOLUMES and isinstance(node.right, ast.BinOp)
        if volume or (isinstance(node.op, ast.Div) and name(node.left) in MODULI):
            found.append(node.lineno)
    return found


def test_volumes_and_compression_are_written_in_one_file() -> None:
    files = [file for file in SOURCES.glob("hydro_*/hydro_*/**/*.py") if "__pycache__" not in file.parts]
    assert len(files) > 300
    elsewhere = [
        f"{file.relative_to(SOURCES)}:{line}" for file in files
        if file != EQUATIONS and not str(file.relative_to(SOURCES)).startswith((*INDEPENDENT, *GENERATED))
        for line in writings(file.read_text(encoding="utf-8"))
    ]  # fmt: skip
    assert elsewhere == []
    assert len(writings(EQUATIONS.read_text(encoding="utf-8"))) == 4  # two volumes, two stiffnesses


@pytest.mark.parametrize(
    "line", ["c[DEAD_A] + c[AREA] * y[2]", "bench.bulk_modulus / volume_a * flow", "BULK / v", "n['modulus'] / v"]
)
def test_a_second_writing_would_be_found(line: str) -> None:
    assert writings(line) == [1]
