# SPDX-License-Identifier: Apache-2.0
"""Copy numbers in compiled code.

`a[:] = b` of two arrays compiles the creation of an error message too, in each function that contains it and again in
each that calls one: two thirds of the compilation time of the networks' gradients. Nothing is checked here: `into` must
be as long as the values.
"""

from __future__ import annotations

from hydro_sim.jit import njit


@njit
def vector(into, values):
    """into[i] = values[i] for all values."""
    for i in range(len(values)):
        into[i] = values[i]


@njit
def matrix(into, values):
    """into[i, j] = values[i, j] for all values."""
    for i in range(values.shape[0]):
        for j in range(values.shape[1]):
            into[i, j] = values[i, j]
