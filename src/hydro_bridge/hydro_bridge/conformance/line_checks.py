# SPDX-License-Identifier: Apache-2.0
"""Checks of the line and of the box's self-description: framing, clock, versions, HELLO, DETAILS."""

from __future__ import annotations

from itertools import pairwise

from hydro_bridge.conformance.host import Host
from hydro_bridge.conformance.readings import Bench, box_info, near
from hydro_bridge.files import bench_file
from hydro_bridge.signals import SAMPLE_PERIOD, Law


def undisturbed(host: Host, bench: Bench) -> str:
    """Check that no sample is missing or repeated, and that every frame is complete."""
    steps = {(b.sequence - a.sequence) % 2**32 for a, b in pairwise(host.new_states)}
    counts = host.decoder.counts
    if steps != {1}:
        return f"sequence steps of {sorted(steps)}"
    return f"{counts.crc_errors} check sums, {counts.malformed} frames are wrong" if counts.malformed else ""


def clock(host: Host, bench: Bench, jitter: float = 200.0, share: float = 0.01) -> str:
    """Check the box's clock: each step within `jitter` [us] of a period, and its rate within `share` of the host's."""
    times = [state.time_us for state in host.new_states]
    steps = [b - a for a, b in pairwise(times)]
    if max(abs(step - 1e6 * SAMPLE_PERIOD) for step in steps) > jitter:
        return f"steps of {min(steps)} to {max(steps)} us"
    arrived = host.arrived[host.marked :]
    pace = (times[-1] - times[0]) * 1e-6 / (arrived[-1] - arrived[0])
    return "" if abs(pace - 1.0) <= share else f"{pace:.4f} s of the box are 1 s of the host"


def hello(host: Host, bench: Bench) -> str:
    """Check that HELLO is complete: a name, ordered limits that include zero, 1 ms, a form of the integral."""
    info = box_info(host)
    if not info.name:
        return "it has no name"
    if not info.integral:
        return "it does not tell the form of its integral"
    if not near(info.sample_period, SAMPLE_PERIOD):
        return f"its sample period is {info.sample_period:g} s"
    if not (info.delta_kp_min <= 0.0 <= info.delta_kp_max and info.delta_ki_min <= 0.0 <= info.delta_ki_max):
        return "its limits of the gains do not hold 0"
    return "" if info.valve_current_max > 0.0 <= info.delta_u_max else "its limits of the current are not positive"


def greeted(host: Host, bench: Bench, within: int, versions: tuple[int, int] | None = None) -> str:
    """Check that the last HELLO was answered, with sequence 1 or more, within some samples plus the line's lag."""
    answers = [(n - host.greeted_at, each) for n, each in host.hellos if n >= host.greeted_at]
    if not answers or answers[0][0] > within + host.lag:
        return f"no HELLO came within {within + host.lag} samples"
    if answers[0][1].sequence == 0:
        return "the answer has sequence 0, which says power-on"
    return ""


def speaks(host: Host, bench: Bench, version: int = 0) -> str:
    """Check that STATE and DETAILS are of this version, 0: of the conversation's, once the greeting is answered."""
    version = version or host.version
    begin = next((n for n, _ in host.hellos if n >= host.greeted_at), host.greeted_at)
    found = {(state.refused is not None) + (state.law_state is not None) + 1 for state in host.states[begin + 1 :]}
    if found != {version}:
        return f"STATE of version {sorted(found)}"
    return "" if (host.details is not None) == (version > 1) else "DETAILS are there from version 2 on"


def details(host: Host, bench: Bench) -> str:
    """Check that DETAILS are complete: an epoch, times and ranges in order."""
    if host.details is None:
        return "none came"
    told = host.details.details
    if not told.epoch:
        return "its epoch is 0"
    if not 0.0 < told.hold_timeout <= told.trip_timeout:
        return f"its time-outs are {told.hold_timeout:g} and {told.trip_timeout:g} s"
    if bool(told.laws >> Law.COMPENSATED & 1) != (host.law is not None):
        return "LAW comes where DETAILS offer the compensated law, and only there"
    ordered = told.pressure_min < told.pressure_max and told.position_min < told.position_max
    return "" if ordered and told.load_force_limit > 0.0 < told.force_range else "a limit is 0, or a range is empty"


def believes(host: Host, bench: Bench) -> str:
    """Check that HELLO and DETAILS agree with the bench file."""
    assert bench is not None
    if not near(box_info(host).valve_current_max, bench["valve_current_max"]):
        return (
            f"valve_current_max {box_info(host).valve_current_max:g} A, the file has {bench['valve_current_max']:g} A"
        )
    told = host.details.details.bench_digest if host.details else ""
    if not told:
        host.notes.append("its digest is not told: only valve_current_max is compared")
    elif told != bench_file.digest(bench):
        return f"its bench is {told}, the file is {bench_file.digest(bench)}"
    return ""
