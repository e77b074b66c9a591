# SPDX-License-Identifier: Apache-2.0
"""The textbook equations within compiled code: `from hydro_sim.model.compiled_equations import equations as eq`.

`model.equations` itself does without numba, whose import takes a second that other uses of a bench need not wait for.
"""

from __future__ import annotations

from types import FunctionType

from numba.extending import overload, register_jitable

from hydro_sim.model import equations

__all__ = ["equations"]


@overload(equations.choose)
def _choose(condition, first, second):
    return lambda condition, first, second: first if condition else second


for _name, _function in vars(equations).items():
    if isinstance(_function, FunctionType) and _function is not equations.choose:
        register_jitable(_function)
