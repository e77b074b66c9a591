# SPDX-License-Identifier: Apache-2.0
"""Writes `model.analytic_kernels`: the slopes of f_h' of `model.analytic_equations`, exact.

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
NUMBERS = ("bulk_modulus", "piston_area", "area_ratio", "dead_volume_a", "dead_volume_b", "stroke", "valve_gain")
ROOTS = ("root_a", "root_b", "slope_a", "slope_b")

HEAD = '''# SPDX-License-Identifier: Apache-2.0
"""Compiled slopes of f_h' of the analytic bench.

Written by `python -m hydro_filter.model.generate` from `analytic_equations`: edit that, not this.
"""

from __future__ import annotations

from hydro_filter.model.analytic_equations import root_slopes
from hydro_sim.jit import njit
'''


def slopes() -> tuple[dict[str, SX], list[SX]]:
    """The symbols by their text in the file, and dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b, dF/du."""
    x, u, roots = [SX.sym(f"x{i}") for i in range(STATES)], SX.sym("u"), [SX.sym(name) for name in ROOTS]
    n = SimpleNamespace(**{name: SX.sym(name) for name in NUMBERS})
    texts = {f"bench.{name}": symbol for name, symbol in vars(n).items()}
    texts |= {f"state[{i}]": symbol for i, symbol in enumerate(x)} | {"current": u}
    force = analytic.force_rate(n, x, u, roots)
    found = [casadi.jacobian(force, x[i]) for i in (POSITION, VELOCITY)]
    found += [casadi.jacobian(force, root) * slope for root, slope in zip(roots[:2], roots[2:], strict=True)]
    return texts | dict(zip(ROOTS, roots, strict=True)), [*found, casadi.jacobian(force, u)]


def source() -> str:
    """The whole file, formatted."""
    texts, found = slopes()
    lines = statements(texts, [(f"{name} = ", value) for name, value in zip(SLOPES, found, strict=True)])
    roots = f"{', '.join(ROOTS)} = root_slopes(bench, state[{PRESSURE_A}], state[{PRESSURE_B}], current)"
    functions = (
        ("force_rate_slopes(bench, state, current)",
         "Slopes of F(x, u) = h + g u, f_h' of eq. q13: dF/dx_p, dF/dx_p', dF/dp_a, dF/dp_b, and g = dF/du.",
         [roots, *lines, f"return {', '.join(SLOPES)}"]),
    )  # fmt: skip
    return formatted(HEAD, functions, FILE)


SLOPES = ("by_position", "by_velocity", "by_a", "by_b", "by_current")

if __name__ == "__main__":
    FILE.write_text(source(), encoding="utf-8")
