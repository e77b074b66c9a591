# SPDX-License-Identifier: Apache-2.0
"""Pairing of learned files with boxes: the bench file and gains that a file was made for, and mismatches.

Metric, policy and agent carry a `Provenance` in their header, entry `made_for` of the JSON `hydro`::

    box        digest of the bench.yaml that the box's force law assumed, not of the simulated bench
    model      digest of the learned bench that a metric or a policy was made on; empty: none was used
    base gains of the box, of policies and agents: their actions are changes to these
    integral   form of the law's integral, where it is known

A file without one matches no box: its origin is unknown.
"""

from __future__ import annotations

import json
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from math import isclose
from pathlib import Path
from typing import Any

import yaml
from safetensors.numpy import load, save

from hydro_bridge.safety.box_info import BoxDescription
from hydro_core.bench_scales import BenchScales
from hydro_core.errors import UserError
from hydro_sim.model.bench import Bench

HEADER_KEY = "made_for"
"""Key of the entry in a file's header."""


class PairingError(UserError):
    """A file does not match the box; the message is one sentence that names the file or command that would."""


@dataclass(frozen=True, kw_only=True)
class Provenance:
    """Provenance of a file: the box, and the learned bench, that it was made for."""

    box: str
    """`Bench.digest` of the bench that the box's force law assumed."""
    model: str = ""
    """`Bench.digest` of the learned bench that was used."""
    base_kp: float | None = None
    """Base K_p of the box [1/s]; None: irrelevant."""
    base_ki: float | None = None
    """Base K_i of the box [1/s^2]; None: irrelevant."""
    integral: str = ""
    """`bumpless` or `paper`; empty: unknown or irrelevant."""
    any_bench: bool = False
    """Whether it was trained on many drawn benches, and matches any of them whose box has these base gains."""


@dataclass(frozen=True, kw_only=True)
class BoxIdentity:
    """Identity of a box, as far as known: its bench file, base gains and integral form."""

    digest: str
    """`Bench.digest` of its bench; empty: unknown."""
    source: str
    """Source of the digest, for messages."""
    base_gains: tuple[float, float] | None = None
    """K_p [1/s], K_i [1/s^2]; None: unknown."""
    integral: str = ""
    size: BenchScales | None = None
    """Size of its bench; None: unknown."""

    @classmethod
    def of_file(cls, path: str | Path | None, base_gains: tuple[float, float] | None = None) -> BoxIdentity:
        """Return the identity of a box configured by this bench.yaml; None: the nominal one."""
        bench = Bench.load(path) if path else Bench.nominal()
        source = str(path or "bench.yaml of hydro_sim")
        return cls(digest=bench.digest, source=source, base_gains=base_gains, size=bench.size)

    @classmethod
    def of_box(cls, box: BoxDescription) -> BoxIdentity:
        """Return the identity of a running box."""
        source = f"/hydro/box of {box.plant or 'the plant'}"
        size, integral = BenchScales.of_known_bench(yaml.safe_load(box.bench)), box.info.integral
        return cls(digest=box.bench_digest, source=source, base_gains=box.base_gains, integral=integral, size=size)

    @property
    def description(self) -> str:
        """Description for messages."""
        return f"{self.digest} ({self.source})"


def parse_provenance(header: Mapping[str, Any]) -> Provenance | None:
    """Return the provenance in a file's header; None if it is missing or unreadable."""
    try:
        return Provenance(**header[HEADER_KEY])
    except (KeyError, TypeError):
        return None


def mismatch(
    thing: str, provenance: Provenance | None, box: BoxIdentity, remedy: str, *, model: str | None = None
) -> str:
    """Return an error message with remedy if `thing` was made for another box; empty if it matches.

    `thing`: object to be paired, by kind and file: "the metric own.safetensors". `provenance`: of `thing`. `box`:
    identity of the box, whose unknown parts are not compared. `remedy`: instruction that ends the message. `model`:
    digest of the learned bench that is used with it; None: none is used.
    """
    if provenance is None:
        return f"{thing} does not say which bench it was made for: {remedy}"
    if box.digest and provenance.box != box.digest and not provenance.any_bench:
        return f"{thing} was made for bench {provenance.box}, the box believes {box.description}: {remedy}"
    if model is not None and provenance.model != model:
        return f"{thing} was made for model {provenance.model or 'none'}, it is to be used with model {model}: {remedy}"
    for name, mine, theirs in zip(
        ("K_p", "K_i"), (provenance.base_kp, provenance.base_ki), box.base_gains or (), strict=False
    ):
        if mine is not None and not isclose(mine, theirs, rel_tol=1e-6, abs_tol=1e-9):
            return f"{thing} was made for a box with base {name} {mine:g}, this one has {theirs:g}: {remedy}"
    if box.integral and provenance.integral and box.integral != provenance.integral:
        return f"{thing} was made for the {provenance.integral} integral, the box runs the {box.integral} one: {remedy}"
    return ""


def raise_if_mismatched(trouble: str) -> None:
    """Raise PairingError with the message `trouble`, unless it is empty."""
    if trouble:
        raise PairingError(trouble)


def header_of(blob: bytes) -> dict[str, Any]:
    """Return the header of this project's files, JSON under `hydro`.

    Raises ValueError if the bytes are not of such a file.
    """
    try:
        outer = json.loads(blob[8 : 8 + int.from_bytes(blob[:8], "little")])  # behind its length, a u64
        header: dict[str, Any] = json.loads(outer["__metadata__"]["hydro"])
        return header
    except (KeyError, TypeError, ValueError) as error:
        raise ValueError("its header has no readable entry 'hydro'") from error


def read_provenance(path: Path) -> Provenance | None:
    """Return the provenance of a file; None if it has none or is of another project."""
    try:
        return parse_provenance(header_of(path.read_bytes()))
    except ValueError:
        return None


def with_provenance(blob: bytes, provenance: Provenance | None) -> bytes:
    """Return a safetensors blob with its provenance replaced; None: removed.

    Raises ValueError: see `header_of`, or the file is incomplete.
    """
    header = {key: value for key, value in header_of(blob).items() if key != HEADER_KEY}
    if provenance is not None:
        header[HEADER_KEY] = asdict(provenance)
    return bytes(save(load(blob), {"hydro": json.dumps(header)}))
