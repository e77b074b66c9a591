# SPDX-License-Identifier: Apache-2.0
"""Log messages at each connection: which limits the box narrows, and what a version 1 box cannot report."""

from __future__ import annotations

from dataclasses import fields

from hydro_bridge.safety.guard import GuardSettings, narrowed
from hydro_bridge.serial.frames import BoxDetails, BoxInfo, BoxLaw

LEAST_BAUD = 1_300_000
"""bit/s below which version 3, and with it the other law, is not spoken: its STATE does not fit between two samples."""
NO_LAW = "only the paper's force law can be run: the box offers no other"
SLOW_LINE = f"only the paper's force law can be run: another needs a line of {LEAST_BAUD} bit/s (--baud)"


def incomplete(version: int, details: BoxDetails | None) -> str:
    """Return a sentence on a box of version 2 or more whose HELLO is not followed by what belongs to it."""
    said, missing = ("DETAILS", "LAW") if details else ("HELLO", "DETAILS")
    return f"the box speaks protocol version {version} and sends no {missing} behind its {said}: no command is sent"


MISSED = (
    "the box speaks protocol version 1: it cannot tell its force and sensor limits, which bench it believes, which "
    "references it refused, and a restart whose HELLO was lost is seen by its sequence only"
)


def connection_remarks(
    wanted: GuardSettings, info: BoxInfo, details: BoxDetails | None, law: BoxLaw | None, baud: int
) -> list[str]:
    """Return sentences for the log; none for a box with both laws that allows everything the guard is set to."""
    said = ([] if details else [MISSED]) + ([] if law else [NO_LAW if baud >= LEAST_BAUD else SLOW_LINE])
    allowed = narrowed(wanted, info)
    changed = [
        f"{entry.name} {getattr(wanted, entry.name):g} -> {getattr(allowed, entry.name):g}"
        for entry in fields(wanted)
        if getattr(wanted, entry.name) != getattr(allowed, entry.name)
    ]
    if changed:
        said.append(f"the box narrows the guard: {', '.join(changed)}")
    if details and 0.0 < details.force_range < wanted.reference_force_max:
        said.append(
            f"the box refuses references beyond {details.force_range:g} N, the guard those beyond "
            f"{wanted.reference_force_max:g} N"
        )
    if details and 0.0 < details.load_force_limit < wanted.reference_force_max:
        said.append(
            f"the box trips beyond a load force of {details.load_force_limit:g} N, the guard takes references up to "
            f"{wanted.reference_force_max:g} N"
        )
    return said
