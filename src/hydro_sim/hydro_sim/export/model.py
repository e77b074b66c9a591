# SPDX-License-Identifier: Apache-2.0
"""A bench as text for other programs: the generated C with its parameters, and the templates around it.

::

    Exported(bench).fmu(Path("bench.fmu"))     binary of this machine, sources, modelDescription.xml
                   .simulink("bench_sfun")     S-function
                   .mujoco()                   Python module
                   .c()

All of them hold the same functions of one integration step as the simulation (`model.assembly`), and nothing of hydro
is needed to run them.
"""

from __future__ import annotations

import hashlib
import io
import json
import platform
import re
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
from hydro_sim.model.assembly import FORCES, READINGS
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import DEAD_TIME, BenchModel
from hydro_sim.model.effects import catalogue
from hydro_sim.model.source import exported_source

FLAGS = ("-std=c99", "-O2", "-fPIC", "-shared", "-fvisibility=hidden")
"""Of the FMU's binary, which is for any machine of this kind: no -march."""
UNITS = dict(zip(READINGS, ("N", "N", "Pa", "Pa", "m"), strict=True))
_TEMPLATES = jinja2.Environment(
    loader=jinja2.PackageLoader("hydro_sim.export"), undefined=jinja2.StrictUndefined, keep_trailing_newline=True,
    autoescape=False,
)  # fmt: skip
_TEMPLATES.filters["quoted"] = json.dumps  # a string of C and of Python


class Exported:
    """A bench, ready to be written for another program.

    Parameters
    ----------
    bench
        Numbers, effects and closures.
    intervals
        `(name, value, low, high)` of numbers with a known 95 % interval, SI units (`intervals_beside`).
    """

    def __init__(self, bench: Bench, intervals: Iterable[tuple[str, float, float, float]] = ()) -> None:
        self.bench, self.model = bench, BenchModel(bench)
        self._intervals = {(name, value): (low, high) for name, value, low, high in intervals}

    @cached_property
    def stepping(self) -> list[str]:
        """Effects with states that only an integration step moves on: no model exchange is possible with them."""
        found = [
            catalogue.label(entry)
            for entry in self.bench.terms
            if not all(one.integrated for one in catalogue.kind_of(entry)[0].effect.states)
        ]
        return [*found, *([DEAD_TIME.split(".")[0]] if self.model.structure.past else [])]

    def c(self) -> str:
        """The model in C99."""
        return self._rendered("model.c.j2")

    def simulink(self, name: str) -> str:
        """The source of a level-2 S-function of this name."""
        return f"#define HYDRO_API static\n{self.c()}{self._rendered('simulink.c.j2', name=name)}"

    def mujoco(self) -> str:
        """A Python module with the model as an actuator of MuJoCo."""
        mass = [one.name for one in self.model.parameters].index("moving_mass")
        step = SAMPLE_PERIOD / self.model.substeps
        return self._rendered("mujoco.py.j2", code=f"#define HYDRO_API static\n{self.c()}", mass=mass, step=step)

    def fmu(self, file: Path) -> bytes:
        """The archive of an FMU of that file's name.

        Raises ValueError: there is no C compiler, or it fails.
        """
        name = re.sub(r"\W|^(?=\d)", "_", file.stem)
        source = f"#define HYDRO_API static\n{self.c()}"
        token = hashlib.sha256(source.encode()).hexdigest()[:32]
        source += self._rendered("fmu.c.j2", token=token, scales=[one.scale for one in self.model.states])
        files = {
            "modelDescription.xml": self._description(name, token),
            "sources/fmu.c": source,
            "sources/buildDescription.xml": self._rendered("buildDescription.xml.j2", name=name),
        }
        with tempfile.TemporaryDirectory() as place:
            library = Path(place) / f"{name}.so"
            machine_code.compile_c(source, library, FLAGS)
            binary = library.read_bytes()
        archive = io.BytesIO()
        with zipfile.ZipFile(archive, "w", zipfile.ZIP_DEFLATED) as packed:
            for path, text in files.items():
                packed.writestr(zipfile.ZipInfo(path), text)
            packed.writestr(zipfile.ZipInfo(f"binaries/{platform.machine()}-linux/{library.name}"), binary)
        return archive.getvalue()

    def _description(self, name: str, token: str) -> str:
        numbers = len(self.model.parameters)
        first, states = 2 + len(READINGS), self._states()
        units = {"s", "A", *UNITS.values(), *(one["unit"] for one in (*self._parameters, *states))} - {"-"}
        return self._rendered(
            "modelDescription.xml.j2", name=name, token=token, units=sorted(units), exchange=not self.stepping,
            step=SAMPLE_PERIOD / self.model.substeps, states=states,
            outputs=[{"name": one, "unit": UNITS[one]} for one in READINGS],
            first_state=first + numbers, first_derivative=first + numbers + len(self.model.states),
            last=first + numbers + 2 * len(self.model.states),
        )  # fmt: skip

    def _states(self) -> list[dict[str, Any]]:
        rest = hydraulics.rest_state(self.bench.constants()[0]).tolist()
        terms = [(catalogue.label(entry), catalogue.kind_of(entry)[0].effect.states) for entry in self.bench.terms]
        labels = [f"{label}." for label, states in terms for _ in states]
        names = [*("" for _ in rest), *labels, *("" for _ in range(self.model.structure.past))]
        return [
            {"name": f"{label}{one.name}", "unit": one.unit, "start": rest[i] if i < len(rest) else None}
            for i, (label, one) in enumerate(zip(names, self.model.states, strict=True))
        ]

    @cached_property
    def _parameters(self) -> list[dict[str, Any]]:
        """Parameters in the model's order, by unique names."""
        numbers, seen = self.bench.quantities(), Counter[str]()
        room = max(self.model.structure.past - 2, 0) * SAMPLE_PERIOD - catalogue.delay(self.bench.effects)
        listed = []
        for i, (one, value) in enumerate(zip(self.model.parameters, self.model.values.tolist(), strict=True)):
            short, own = one.name.rpartition(".")[2], i < len(numbers)
            seen[one.name] += 1
            name = one.name if seen[one.name] == 1 else f"{one.name}[{seen[one.name]}]"
            listed.append({
                "name": f"bench.{name}" if own else name, "unit": one.unit, "value": value, "low": one.low,
                "high": value + room if one.name == DEAD_TIME else one.high, "reference": 2 + len(READINGS) + i,
                "meaning": numbers[one.name].meaning if own else "", "ci95": self._intervals.get((short, value)),
            })  # fmt: skip
        return listed

    def _rendered(self, template: str, **values: Any) -> str:
        structure, symbols = self.model.structure, self.model.symbols()
        origin = f"Bench {self.bench.digest} with {', '.join(structure.labels) or 'no effects'}, by hydro_sim export."
        return _TEMPLATES.get_template(template).render(
            origin=origin, source=exported_source(symbols, self.model.substeps), parameters=self._parameters,
            forces=FORCES, dry_friction=int(symbols.dry_friction), ideal_cell=int(symbols.ideal_cell), **values,
        )  # fmt: skip
