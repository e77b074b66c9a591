# SPDX-License-Identifier: Apache-2.0
"""Derivatives in Python are generated: the files are what the equations of today give."""

from __future__ import annotations

import math

import casadi
import pytest

from hydro_filter.model import generate as analytic
from hydro_sim.model import equations as eq
from hydro_sim.model.python_source import statements


def test_the_generated_file_is_that_of_the_equations() -> None:
    assert analytic.FILE.read_text(encoding="utf-8") == analytic.source()


def test_statements_give_what_the_expressions_are() -> None:
    """Brackets, shared terms and reciprocals, and conditions: on both sides of each, against CasADi's own values."""
    x, y, z = (casadi.SX.sym(name) for name in "xyz")
    shared = casadi.sqrt(x * x + 2.0) / (y - z)
    value = eq.choose(z >= 0.3, shared - (x - (y - z)), -shared) / (2.0 * y) + casadi.exp(-((shared - x) ** 2))
    outputs = [("f = ", value), ("g = ", casadi.gradient(value, x)), ("h = ", casadi.gradient(value, z))]
    lines = statements({"x": x, "y": y, "z": z}, outputs)
    known = casadi.Function("known", [x, y, z], [expression for _, expression in outputs])
    for point in ((0.4, 1.7, 0.1), (-0.8, 2.5, 0.9), (1.3, -0.6, 0.3)):
        scope = {"math": math, **dict(zip("xyz", point, strict=True))}
        exec("\n".join(lines), scope)
        assert [scope[name] for name in "fgh"] == pytest.approx([float(one) for one in known(*point)], rel=1e-13)
