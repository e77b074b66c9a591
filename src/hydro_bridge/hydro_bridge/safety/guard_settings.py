# SPDX-License-Identifier: Apache-2.0
"""Settings of the guard, and the check of references against them."""

from __future__ import annotations

from array import array
from dataclasses import dataclass, replace
from math import isfinite
from typing import Annotated

from hydro_bridge.serial.protocol import BoxInfo
from hydro_core.bench_scales import BenchScales
from hydro_core.settings import described, quantity
from hydro_core.signals import ReferenceSignal, Waveform


@dataclass(frozen=True, kw_only=True)
class GuardSettings:
    """Limits of commands, and ages. Defaults: the paper's Table training_agent and the failure table of failures.md."""

    delta_kp_min: Annotated[float, quantity("1/s", -200.0, 0.0, "Smallest change of the proportional gain")] = 0.0
    delta_kp_max: Annotated[float, quantity("1/s", 0.0, 500.0, "Largest change of the proportional gain")] = 75.0
    delta_ki_min: Annotated[float, quantity("1/s^2", -50.0, 0.0, "Smallest change of the integral gain")] = 0.0
    delta_ki_max: Annotated[float, quantity("1/s^2", 0.0, 100.0, "Largest change of the integral gain")] = 10.0
    delta_u_max: Annotated[float, quantity("A", 0.0, 20.0, "Largest correction; shipped metric needs 0.0045")] = 0.02
    reference_force_max: Annotated[float, quantity("N", 0.0, 1e8, "Largest |offset| plus amplitude")] = 1000.0
    reference_frequency_max: Annotated[float, quantity("Hz", 0.1, 100.0, "Largest frequency of the reference")] = 20.0
    correction_age_max: Annotated[float, quantity("s", 0.001, 0.2, "An older correction or sample is stale")] = 0.02
    correction_hold: Annotated[
        float, quantity("s", 0.001, 0.2, "An older one acts no more; the gains it allows go on (decision 0064)")
    ] = 0.003
    gains_age_max: Annotated[float, quantity("s", 0.01, 2.0, "Older gains are stale")] = 0.2
    gains_timeout: Annotated[
        float, quantity("s", 2.0, 3600.0, "Without gains, after there were some since arming: reference 0 N, disarmed")
    ] = 10.0
    relies_on: Annotated[
        str, described("The filter that gains of this range need to be safe; nothing: the bench bears them all")
    ] = "nothing"
    require_filter: Annotated[
        bool, described("Without a fresh correction: base gains; false: gains pass, logged and flagged")
    ] = True

    @classmethod
    def of_size(cls, size: BenchScales) -> GuardSettings:
        """Return the usual limits for a bench of this size; the defaults are those of the nominal bench."""
        return cls(delta_u_max=size.current / 2.5, reference_force_max=size.force * 10.0 / 3.0)


UNFILTERED_LIMITS = GuardSettings()
"""Ranges of delta_kp and delta_ki that every bench of this kind tolerates without a filter: the paper's, K_p 15 to 90
and K_i 5 to 15 on base gains of 15 and 5. They apply, whatever the guard's limits, while the filter says MISMATCH."""


def intersect_limits(wanted: GuardSettings, box: BoxInfo) -> GuardSettings:
    """Return the intersection of the guard's limits with the box's."""
    return replace(
        wanted,
        delta_kp_min=max(wanted.delta_kp_min, box.delta_kp_min),
        delta_kp_max=min(wanted.delta_kp_max, box.delta_kp_max),
        delta_ki_min=max(wanted.delta_ki_min, box.delta_ki_min),
        delta_ki_max=min(wanted.delta_ki_max, box.delta_ki_max),
        delta_u_max=min(wanted.delta_u_max, box.delta_u_max),
    )


def reference_error(signal: ReferenceSignal, limits: GuardSettings) -> str:
    """Return the reason to refuse a reference, as given or as the float32 that a box receives; empty if acceptable."""
    if signal.waveform not in tuple(Waveform):
        return f"unknown waveform {signal.waveform}"
    given = (signal.amplitude, signal.offset, signal.frequency, signal.phase)
    for numbers in (given, array("f", given)):  # as float32 tiny numbers are 0, and huge ones infinite
        amplitude, offset, frequency, _ = numbers
        if not all(map(isfinite, numbers)):
            return "a number in it is not finite"
        if amplitude < 0.0 or amplitude + abs(offset) > limits.reference_force_max:
            return f"amplitude {amplitude:g} N, offset {offset:g} N; limit {limits.reference_force_max:g} N"
        if not 0.0 < frequency <= limits.reference_frequency_max and signal.waveform != Waveform.HOLD:
            return f"frequency {frequency:g} Hz is outside (0, {limits.reference_frequency_max:g}]"
    return ""
