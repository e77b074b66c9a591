# SPDX-License-Identifier: Apache-2.0
"""Frames that a box sends, encoded by the host's layouts: STATE, DETAILS and LAW."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import astuple

from hydro_bridge.serial import protocol
from hydro_core.signals import Law

_DISARMED = protocol.LawState()  # with a measured force of 0 N


def encode_state(
    sequence: int,
    time_us: int,
    values: Sequence[float],
    flags: int,
    last_command: int,
    refused: tuple[int, int] = (0, 0),
    law_state: protocol.LawState = _DISARMED,
) -> bytes:
    """Encode STATE, one sample; `values` are sent as float32, beyond its range as infinity.

    `sequence` counts box samples and wraps at 2^32, `time_us` is the box's clock. `last_command` is 0 before the first;
    the host measures the round trip with it. `refused`: counts of refused values and references.
    """
    law, value, rate, coefficients, *scales = law_state
    counts = flags, last_command, *(count & 0xFFFFFFFF for count in refused)
    return protocol.encode(
        protocol.FrameType.STATE, sequence, time_us, *values, *counts, law, value, rate, *coefficients, *scales
    )


def encode_details(sequence: int, time_us: int, details: protocol.BoxDetails) -> bytes:
    """Encode DETAILS, which follow each HELLO of a box."""
    epoch, digest, feedback, laws, *numbers = astuple(details)
    who = (epoch & 0xFFFFFFFF, digest.encode()[:12], protocol.FEEDBACK_FORCES.index(feedback), laws)
    return protocol.encode(protocol.FrameType.DETAILS, sequence, time_us, *who, *numbers)


def encode_law(sequence: int, time_us: int, record: protocol.BoxLaw) -> bytes:
    """Encode LAW, the compensated law of a box; it follows DETAILS that offer this law."""
    *numbers, lowest, highest, fastest = astuple(record)
    return protocol.encode(
        protocol.FrameType.LAW, sequence, time_us, Law.COMPENSATED, *numbers, *lowest, *highest, *fastest
    )
