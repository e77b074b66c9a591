# SPDX-License-Identifier: Apache-2.0
"""Writes `structured.derivatives`: compiled code's partial derivatives and gradients of `structured.physics`, exact.

`python -m hydro_sim.structured.generate` after a change of `physics` or of `model.equations`; a test compares.
"""

from __future__ import annotations

from pathlib import Path

import casadi
from casadi import SX

from hydro_sim.model.python_source import formatted, statements
from hydro_sim.structured import physics

FILE = Path(__file__).with_name("derivatives.py")
CONSTANTS = [name for name in vars(physics) if isinstance(vars(physics)[name], int) and name != "CONSTANTS"]
UNLEARNED = ("STROKE",)
"""Constants by which no gradient is needed."""

HEAD = '''# SPDX-License-Identifier: Apache-2.0
"""Derivatives of `structured.physics`, written by `python -m hydro_sim.structured.generate`: edit that, not this.

Where a slope jumps (a valve's edge at zero opening, a velocity of zero) the derivative is that of the side the model is
on. End stops have none: training never reaches them.
"""

from __future__ import annotations

import math

from hydro_sim.jit import njit
from hydro_sim.structured.physics import ('''


class Symbols:
    """The arguments of `physics`, and their names in the code."""

    def __init__(self) -> None:
        self.c = [SX.sym(name) for name in CONSTANTS]
        self.y, self.r, self.g = (
            [SX.sym(f"{name}{i}") for i in range(size)] for name, size in (("y", 8), ("r", 3), ("g", 8))
        )
        self.z, self.current, self.velocity = SX.sym("z"), SX.sym("u"), SX.sym("v")
        self.texts = {f"c[{name}]": symbol for name, symbol in zip(CONSTANTS, self.c, strict=True)}
        for name in ("y", "r", "g"):
            self.texts |= {f"{name}[{i}]": symbol for i, symbol in enumerate(getattr(self, name))}
        self.texts |= {name: getattr(self, name) for name in ("z", "current", "velocity")}

    def rates_under(self, against: SX | float) -> SX:
        """y' with forces [N] against the motion."""
        slope = [SX(0.0)] * len(self.y)
        physics.rates_under(self.c, self.y, self.current, self.r, against, slope)
        return casadi.vertcat(*slope)


def partials(at: Symbols) -> list[str]:
    """y' and d(y')/d(y, r) without friction; the entries that are never 0, but in rows that repeat a state."""
    slope = at.rates_under(0.0)
    by = casadi.vertcat(*at.y, *at.r)
    jacobian = casadi.sparsify(casadi.jacobian(slope, by))
    outputs = [(f"slope[{i}] = ", slope[i]) for i in range(8)]
    for row, column in zip(*jacobian.sparsity().get_triplet(), strict=True):
        if not jacobian[row, column].is_constant():
            outputs.append((f"p[{row}, {column + (column >= 8)}] = ", jacobian[row, column]))
    return statements(at.texts, outputs)


def friction_partials(at: Symbols) -> list[str]:
    """Dry friction, and its slopes by velocity and bristle."""
    dry = physics.friction(at.c, at.velocity, at.z)
    slopes = casadi.jacobian(dry, casadi.vertcat(at.velocity, at.z))
    names = ("dry = ", "by_velocity = ", "by_bristle = ")
    return [
        *statements(at.texts, list(zip(names, (dry, slopes[0], slopes[1]), strict=True))),
        "return dry, by_velocity, by_bristle",
    ]


def source() -> str:
    """The whole file, formatted."""
    functions = (
        ("partials(c, y, current, r, slope, p)", partials,
         "y' and, in rows 0, 1, 3, 5, 7 of p, d(y')/d(y, z, r): both without dry friction."),
        ("friction_partials(c, velocity, z)", friction_partials, "Dry friction [N]; its slopes by velocity, bristle."),
    )  # fmt: skip
    written = [(signature, text, write(Symbols())) for signature, write, text in functions]
    code = "".join(line for _, _, lines in written for line in lines)
    names = "".join(f"    {name},\n" for name in sorted(CONSTANTS) if f"[{name}]" in code)
    return formatted(f"{HEAD}\n{names})\n", written, FILE)


if __name__ == "__main__":
    FILE.write_text(source(), encoding="utf-8")
