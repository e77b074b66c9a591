# SPDX-License-Identifier: Apache-2.0
"""Description of a box, published on /hydro/box: its HELLO and DETAILS, and the bench file of its force law."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from math import isclose
from typing import Any

import yaml

from hydro_bridge.safety.readiness import Requirement
from hydro_bridge.serial.protocol import BoxDetails, BoxInfo
from hydro_core.files import bench_digest
from hydro_core.signals import SAMPLE_PERIOD

_FLOAT32_TOLERANCE = 1e-6  # relative: HELLO carries float32


@dataclass(frozen=True, kw_only=True)
class BoxDescription:
    """Description of a box: its HELLO, its plant node, and the bench of its force law."""

    info: BoxInfo
    plant: str = ""
    """Node that published the description: bridge or sim."""
    bench_digest: str = ""
    """Digest of the bench parameters assumed by its force law; empty: unknown."""
    bench: str = ""
    """Bench parameters assumed by its force law, as bench.yaml; empty: unknown."""

    @property
    def base_gains(self) -> tuple[float, float]:
        """Base gains K_p [1/s] and K_i [1/s^2], to which the gain changes of commands are added."""
        return self.info.base_kp, self.info.base_ki


def box_info_requirement(ready: Callable[[], bool]) -> Requirement:
    """Return the requirement for arming that the plant's node has published the box's description."""
    return Requirement(
        name="the box's description",
        ready=ready,
        hint="its node publishes it on /hydro/box",
        timeout=5.0,
        timeout_message="no node describes the box on /hydro/box: start a bridge or a sim of this version",
    )


def describe_box(
    info: BoxInfo, bench: Mapping[str, Any] | None, plant: str, details: BoxDetails | None = None
) -> BoxDescription:
    """Return the description of a box from its reports and its bench file; where they differ, the box's values apply.

    The bench's digest is that of the file unless the box contradicts it. If the box reports another digest, its bench
    parameters are unknown.
    """
    believed = details.bench_digest if details else ""
    if bench is None or (believed and believed != bench_digest.digest(bench)):
        return BoxDescription(info=info, plant=plant, bench_digest=believed)
    numbers = dict(bench)
    told = numbers.get("valve_current_max")
    if told is None or not isclose(info.valve_current_max, told, rel_tol=_FLOAT32_TOLERANCE):
        numbers["valve_current_max"] = info.valve_current_max
    text = yaml.safe_dump(numbers, sort_keys=False)
    return BoxDescription(info=info, plant=plant, bench_digest=bench_digest.digest(numbers), bench=text)


def bench_mismatches(info: BoxInfo, bench: Mapping[str, Any] | None, details: BoxDetails | None = None) -> str:
    """Return the differences of box and bench file, with both values, as one sentence; empty without any."""
    found, bench = [], bench or {}
    believed, told = details.bench_digest if details else "", bench.get("valve_current_max")
    if believed and bench and believed != (digest := bench_digest.digest(bench)):
        found.append(f"its force law believes the bench {believed}, the bench file is {digest}")
    if told is not None and not isclose(info.valve_current_max, told, rel_tol=_FLOAT32_TOLERANCE):
        found.append(f"its valve_current_max is {info.valve_current_max:g} A, the bench file says {told:g} A")
    if not isclose(info.sample_period, SAMPLE_PERIOD, rel_tol=_FLOAT32_TOLERANCE):
        found.append(f"its sample period is {info.sample_period:g} s, here {SAMPLE_PERIOD:g} s is expected")
    return "; ".join(found)
