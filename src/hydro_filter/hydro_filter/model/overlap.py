# SPDX-License-Identifier: Apache-2.0
"""Overlap of a valve, compiled: what of a current passes it, and the change of current after which more passes.

Within the overlap no current moves the piston (B = 0): a correction that ends there does nothing. The bench file says
how wide it is, so the certificate counts what passes (`passed`), asks for a change of that, and the correction is the
smallest change of the valve's current that makes it (`change_for`), across the overlap where it has to be::

    what passes            /        o: opening, the current less the one that closes the valve
              ____________/         0 for -back <= o <= out, less by the overlap beyond
             /   |  0  |
            /  -back  out

Without an overlap nothing changes. The spool's lag is neglected: for some milliseconds after a change of sides the
spool is still within. Source: Merritt 1967, sections 5-3 to 5-6; `hydro_sim.model.effects.valve`.
"""

from __future__ import annotations

from typing import NamedTuple

from hydro_sim.jit import njit


class Overlap(NamedTuple):
    """Overlap of a valve; none by default."""

    closing: float = 0.0
    """A, current that closes the valve."""
    back: float = 0.0
    """A, half width on the side of negative openings, 0 or more."""
    out: float = 0.0
    """A, half width on the other side, 0 or more."""


@njit
def lost(overlap, current):
    """Return the part of a current [A] that does not pass."""
    return min(max(current - overlap.closing, -overlap.back), overlap.out)


@njit
def passed_change(overlap, current, change):
    """Return how much more passes [A] after a change [A] of a current [A]."""
    return change - (lost(overlap, current + change) - lost(overlap, current))


@njit
def change_for(overlap, current, passing):
    """Return the smallest change [A] of a current [A] after which `passing` [A] more of it passes."""
    if passing == 0.0 or (overlap.back == 0.0 and overlap.out == 0.0):
        return passing
    opening = current - overlap.closing
    wanted = opening - lost(overlap, current) + passing
    if wanted == 0.0:
        return lost(overlap, current) - opening
    return wanted + (overlap.out if wanted > 0.0 else -overlap.back) - opening
