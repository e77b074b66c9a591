# SPDX-License-Identifier: Apache-2.0
"""numba's `njit` with the options of all kernels of hydro: cached, and with IEEE 754 division.

numba's own default follows Python: a division by zero raises. At the valve nothing may raise on a sample, and a sample
can make a divisor zero: at some position a chamber's volume vanishes. Here this gives an infinity or NaN, which every
caller has to reject anyway. Used bare (`@njit`) or with more options (`@njit(inline="always")`).
"""

from __future__ import annotations

from functools import partial

import numba

njit = partial(numba.njit, cache=True, error_model="numpy")


@njit
def copy_vector(into, values):
    """Copy a vector, into[i] = values[i], unchecked: `into` must be as long as `values`.

    `into[:] = values` would compile the creation of an error message too, in each function that contains it and again
    in each that calls one: two thirds of the compilation time of the networks' gradients.
    """
    for i in range(len(values)):
        into[i] = values[i]
