# SPDX-License-Identifier: Apache-2.0
"""corrected.yaml: the bench with wrong values corrected and other effects listed under `effects`.

`Bench.load` accepts the file in place of bench.yaml; `claims_of` converts its effects back into claims, for a
simulation or a second diagnosis.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import yaml

from hydro_core.files.atomic import write_atomic
from hydro_diagnosis.effects import LIBRARY
from hydro_diagnosis.effects.base import EffectHypothesis, claims_acting_in
from hydro_diagnosis.effects.closure import from_mapping, is_closure
from hydro_sim.model.bench import Bench

HEADER = """\
# What the bench is, by a diagnosis; SI units. The model: of filter and metric (--model), of a simulation.
# The box believes its own bench.yaml, and goes on with that: nothing of this file belongs into it, unless a number
# here (not under effects or closures) differs from there and you want the force law to know.
"""


def corrected_bench(bench: Bench, claims: Sequence[EffectHypothesis]) -> Bench:
    """Bench corrected by claims: its parameters are replaced, closures and other effects are appended to its own.

    A wrong bulk modulus or valve gain replaces the bench's parameter, unless an earlier effect acts on the same
    quantity (air in the oil, say): then their order matters, and it is appended as an effect.
    """
    before = list(claims_of(bench))
    effects: list[Mapping[str, Any]] = list(bench.effects)
    for claim in claims:
        if is_closure(claim.effect):
            bench = replace(bench, closures=(*bench.closures, claim.effect.to_closure(claim.values)))
            continue
        hooks = [hook for hook in ("modulus", "openings") if claim.effect.acts_in(hook)]
        changed = bench if claims_acting_in(before, *hooks) else claim.effect.write_into_bench(bench, claim.values)
        if changed == bench or claim.effect.id == "sensor_lag":
            effects.append(claim.to_mapping())
            before.append(claim)
        else:
            bench = replace(changed, effects=())
    return replace(bench, effects=tuple(effects))


def write_corrected(bench: Bench, claims: Sequence[EffectHypothesis], path: Path) -> None:
    """Write corrected.yaml of a bench and claims; unknown parameters of the bench are omitted."""
    write_atomic(path, corrected_yaml(corrected_bench(bench, claims)).encode())


def corrected_yaml(bench: Bench) -> str:
    """Return the text of corrected.yaml for a corrected bench."""
    return HEADER + yaml.safe_dump(bench.to_mapping(), sort_keys=False)


def claims_of(bench: Bench) -> tuple[EffectHypothesis, ...]:
    """Claims for the effects and closures of a corrected bench. Raises ValueError if an effect is unknown."""
    claims = []
    for entry in bench.effects:
        options = {key: value for key, value in entry.items() if key not in ("id", "parameters")}
        effect = next((one for one in LIBRARY if one.id == entry["id"] and dict(one.options) == options), None)
        if effect is None:
            raise ValueError(f"effect {entry['id']!r} with {options} is not known to the diagnosis")
        values = {one.name: float(entry["parameters"][one.name]) for one in effect.parameters}
        claims.append(EffectHypothesis(effect.adapted(bench), values))
    return (*claims, *(EffectHypothesis(*from_mapping(entry, bench)) for entry in bench.closures))
