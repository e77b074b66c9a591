# SPDX-License-Identifier: Apache-2.0
"""Export formats of a bench model: generated C with its parameters, in a template for each program.

All of them run the same functions of one integration step as the simulation (`model.assembly`), without any other
part of hydro.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import tempfile
import zipfile
from collections import Counter
from collections.abc import Iterable
from functools import cached_property
from pathlib import Path
from typing import Any

import jinja2

from hydro_core.signals import SAMPLE_PERIOD
from hydro_sim.model import hydraulics, machine_code
from hydro_sim.model.assembly import FORCE_NAMES
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import DEAD_TIME_PARAMETER, BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.equations import READINGS
from hydro_sim.model.source import exported_source

COMPILER_FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
"""Compiler flags of the FMU's binary, which is portable among processors of this architecture: no -march."""
OUTPUT_UNITS = dict(zip(READINGS, ("N", "N", "Pa", "Pa", "m"), strict=True))
"""Outputs with their units."""
FIRST_PARAMETER_REFERENCE = 2 + len(OUTPUT_UNITS)
"""First value reference of an FMU's parameters, after time, current and outputs."""
_TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("hydro_sim.export"), undefined=jinja2.StrictUndefined, keep_trailing_newline=True
)
_TEMPLATES.filters["quoted"] = json.dumps  # a string of C and of Python


class ExportedModel:
    """Bench model for export to other programs.

    `intervals`: name, value and 95 % interval of estimated parameters, SI units.
    """

    def __init__(self, bench: Bench, intervals: Iterable[tuple[str, float, float, float]] = ()) -> None:
        self.bench, self.model = bench, BenchModel(bench)
        self._intervals = {(name, value): (low, high) for name, value, low, high in intervals}

    @property
    def discrete_effects(self) -> list[str]:
        """Effects with discrete states, which rule out FMI model exchange."""
        kinds = {catalogue.label(entry): catalogue.parse_entry(entry)[0].effect for entry in self.bench.terms}
        found = [
            label for label, kind in kinds.items()
            if not (kind.acts_in("continuous_rates") or all(one.integrated for one in kind.states))
        ]  # fmt: skip
        return [*found, *([DEAD_TIME_PARAMETER.partition(".")[0]] if self.model.structure.past_currents else [])]

    def c_source(self) -> str:
        """Return the model's C99 source."""
        return self._rendered("model.c.j2", source=exported_source(self.model.symbols(), self.model.substeps))

    def simulink(self, name: str) -> str:
        """Return the source of a level-2 S-function of this name."""
        return self._static + self._rendered("simulink.c.j2", name=name)

    def mujoco(self) -> str:
        """Return a Python module with the cylinder as an actuator of MuJoCo."""
        mass = [one.name for one in self.model.parameters].index("moving_mass")
        return self._rendered("mujoco.py.j2", code=self._static, mass=mass)

    def fmu(self, name: str) -> bytes:
        """Return the archive of an FMU with this model identifier.

        Raises ValueError: there is no C compiler, or it fails.
        """
        token = hashlib.sha256(self._static.encode()).hexdigest()[:32]
        common = {"name": name, "token": token, "exchange": not self.discrete_effects}
        scales = [one.scale for one in self.model.states]
        source = self._static + self._rendered("fmu.c.j2", scales=scales, **common)
        with tempfile.TemporaryDirectory() as place:
            library = Path(place) / f"{name}.so"
            machine_code.compile_c(source, library, COMPILER_FLAGS)
            binary = library.read_bytes()
        files: dict[str, str | bytes] = {
            "modelDescription.xml": self._description(common),
            "sources/fmu.c": source,
            "sources/buildDescription.xml": self._rendered("buildDescription.xml.j2", **common),
            f"binaries/{platform.machine()}-linux/{name}.so": binary,
        }
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w") as packed:
            for path, content in files.items():
                packed.writestr(zipfile.ZipInfo(path), content, zipfile.ZIP_DEFLATED)
        return archive.getvalue()

    def _description(self, common: dict[str, Any]) -> str:
        """modelDescription.xml; without model exchange of the states only those that may be set."""
        exchange, count = common["exchange"], len(self.model.states)
        rest = hydraulics.rest_state(self.bench.constants()[0]).tolist()
        terms = [(catalogue.label(entry), catalogue.parse_entry(entry)[0].effect.states) for entry in self.bench.terms]
        labels = [*("" for _ in rest), *(f"{label}." for label, states in terms for _ in states)]
        names = unique_names(f"{label}{one.name}" for label, one in zip(labels, self.model.states, strict=False))
        first = FIRST_PARAMETER_REFERENCE + len(self.model.parameters)
        states = [
            {"name": name, "unit": one.unit, "reference": first + i, "derivative": first + count + i}
            for i, (name, one) in enumerate(zip(names, self.model.states, strict=False))
        ][: None if exchange else 4]
        sliding = first + 2 * count if exchange and self.model.symbols().dry_friction else None
        unknown = [one["reference"] for one in states[4:]] + [one["derivative"] for one in states if exchange]
        units = {"s", "A", *OUTPUT_UNITS.values(), *(one["unit"] for one in (*self._parameters, *states))} - {"-"}
        return self._rendered(
            "modelDescription.xml.j2", outputs=OUTPUT_UNITS, units=sorted(units), states=states, start=rest,
            sliding=sliding, unknown=[*range(2, FIRST_PARAMETER_REFERENCE), *unknown], **common,
        )  # fmt: skip

    @cached_property
    def _static(self) -> str:
        return f"#define HYDRO_API static\n{self.c_source()}"

    @cached_property
    def _parameters(self) -> list[dict[str, Any]]:
        """Parameters in the model's order, by unique names."""
        numbers, listed = self.bench.quantities(), list[dict[str, Any]]()
        names = unique_names(
            f"bench.{one.name}" if i < len(numbers) else one.name for i, one in enumerate(self.model.parameters)
        )
        longest = max(self.model.structure.past_currents - 2, 0) * SAMPLE_PERIOD
        room = longest - catalogue.total_delay(self.bench.effects)
        for i, (one, value) in enumerate(zip(self.model.parameters, self.model.values.tolist(), strict=True)):
            listed.append({
                "name": names[i], "unit": one.unit, "value": value,
                "low": one.low, "high": value + room if one.name == DEAD_TIME_PARAMETER else one.high,
                "reference": FIRST_PARAMETER_REFERENCE + i,
                "meaning": numbers[one.name].meaning if i < len(numbers) else "",
                "ci95": self._intervals.get((one.name.rpartition(".")[2], value)),
            })  # fmt: skip
        return listed

    def _rendered(self, template: str, **values: Any) -> str:
        symbols, labels = self.model.symbols(), self.model.structure.labels
        return _TEMPLATES.get_template(template).render(
            origin=f"Bench {self.bench.digest} with {', '.join(labels) or 'no effects'}; by hydro_sim export.",
            parameters=self._parameters, forces=FORCE_NAMES, dry_friction=int(symbols.dry_friction),
            ideal_cell=int(symbols.ideal_cell), step=SAMPLE_PERIOD / self.model.substeps, **values,
        )  # fmt: skip


def unique_names(names: Iterable[str]) -> list[str]:
    """Return the names with [2], [3], ... appended to repeated ones."""
    seen, found = Counter[str](), list[str]()
    for name in names:
        seen[name] += 1
        found.append(name if seen[name] == 1 else f"{name}[{seen[name]}]")
    return found
