# SPDX-License-Identifier: Apache-2.0
"""Writes `model.analytic_kernels`: x', A, B and the slopes of f_h' of `model.analytic_equations`, exact.

`python -m hydro_filter.model.generate` after a change of those or of `hydro_sim.model.equations`; a test compares.
"""

from __future__ import annotations

from pathlib import Path
from types import SimpleNamespace

import casadi
from casadi import SX

from hydro_filter.model import analytic_equations as analytic
from hydro_filter.model.state import POSITION, PRESSURE_A, PRESSURE_B, STATES, VELOCITY
from hydro_sim.model.python_source import formatted, statements

FILE = Path(__file__).with_name("analytic_kernels.py")
NUMBERS = (
    "bulk_modulus", "piston_area", "area_ratio", "dead_volume_a", "dead_volume_b", "stroke", "valve_gain",
    "viscous_friction", "moving_mass", "spring_stiffness", "spring_rest_position",
)  # fmt: skip
ROOTS = ("root_a", "root_b", "slope_a", "slope_b", "bend_a", "bend_b")
MOVED = (POSITION, VELOCITY, PRESSURE_A, PRESSURE_B)
"""States that move F."""

HEAD = '''# SPDX-License-Identifier: Apache-2.0
"""Compiled analytic bench of `dynamics`: x' = f(x, u) with exact A and B, and the slopes of f_h'.

Written by `python -m hydro_filter.model.generate` from `analytic_equations`: edit that, not this.
"""

from __future__ import annotations

from hydro_filter.model.analytic_equations import root_slopes
from hydro_sim.jit import njit
'''


class Analytic:
    """The equations as symbols."""

    def __init__(self) -> None:
        self.x, self.u = [SX.sym(f"x{i}") for i in range(STATES)], SX.sym("u")
        self.roots = [SX.sym(name) for name in ROOTS]
        n = SimpleNamespace(**{name: SX.sym(name) for name in NUMBERS})
        self.texts = {f"bench.{name}": symbol for name, symbol in vars(n).items()}
        self.texts |= {f"state[{i}]": symbol for i, symbol in enumerate(self.x)} | {"current": self.u}
        self.texts |= dict(zip(ROOTS, self.roots, strict=True))
        force = analytic.force_rate(n, self.x, self.u, self.roots)
        self.slopes = [self.slope(force, i) for i in MOVED]
        rates = analytic.rates(n, self.x, self.u, self.roots, 0.0)
        bend = sum(slope * rates[i] for slope, i in zip(self.slopes, (6, 7, 4, 5), strict=True))
        self.rates = analytic.rates(n, self.x, self.u, self.roots, bend)

    def slope(self, expression: SX, state: int) -> SX:
        """Derivative by a state, also by way of its pressure's root and the root's slope."""
        total = casadi.jacobian(expression, self.x[state])
        chamber = {PRESSURE_A: 0, PRESSURE_B: 1}.get(state)
        if chamber is not None:
            root, slope, bend = self.roots[chamber::2]
            total += casadi.jacobian(expression, root) * slope + casadi.jacobian(expression, slope) * bend
        return total


def with_roots(lines: list[str]) -> list[str]:
    """The lines after one with the roots and slopes that they use."""
    names = ", ".join(name if any(name in line for line in lines) else "_" for name in ROOTS)
    return [f"{names} = root_slopes(bench, state[{PRESSURE_A}], state[{PRESSURE_B}], current)", *lines]


def source() -> str:
    """The whole file, formatted."""
    at, bench = Analytic(), "bench = constants[0]"
    rate = [(f"out[{i}] = ", SX(value)) for i, value in enumerate(at.rates)]
    matrix = [
        (f"state_matrix[{i}, {j}] = ", slope)
        for i, value in enumerate(at.rates) for j in range(STATES) if not (slope := at.slope(SX(value), j)).is_zero()
    ]  # fmt: skip
    vector = [(f"input_vector[{i}] = ", casadi.jacobian(SX(value), at.u)) for i, value in enumerate(at.rates)]
    slopes = [(f"{name} = ", value) for name, value in zip(SLOPES, at.slopes, strict=True)]
    functions = (
        ("state_rate(constants, state, current, out)", "Write x' into `out`, shape (8,); `constants` of shape (1,).",
         [bench, *with_roots(statements(at.texts, rate))]),
        ("linearize(constants, state, current, state_matrix, input_vector)",
         "Write A, shape (8, 8), and B, shape (8,); `constants` of shape (1,).",
         [bench, "state_matrix[:] = 0.0", *with_roots(statements(at.texts, [*matrix, *vector]))]),
        ("force_rate_slopes(bench, state, current)",
         "Slopes of F(x, u) = h + g u, f_h' of eq. q13: dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b.",
         [*with_roots(statements(at.texts, slopes)), f"return {', '.join(SLOPES)}"]),
    )  # fmt: skip
    return formatted(HEAD, functions, FILE)


SLOPES = ("by_position", "by_velocity", "by_a", "by_b")

if __name__ == "__main__":
    FILE.write_text(source(), encoding="utf-8")
