# SPDX-License-Identifier: Apache-2.0
"""Every effect of the catalogue in every part that takes a bench file, one at a time."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from hydro_filter.metric import MetricDesign, closed_loop_at_rest, spectral_radius
from hydro_filter.model.loop import SUBSTEPS, make_loop, make_samples
from hydro_filter.model.records import linearize, new_memories
from hydro_sim.files import recordings
from hydro_sim.identification.bench_learning import learn
from hydro_sim.model.bench import Bench
from hydro_sim.model.bench_model import BenchModel
from hydro_sim.model.effects.catalogue import CATALOGUE, parse_entry
from tests.segments import record

BENCH = Bench.nominal()
COULOMB: Mapping[str, Any] = {"id": "friction_coulomb", "parameters": {"force": 10.0}}
LAG: Mapping[str, Any] = {"id": "valve_lag", "parameters": {"bandwidth": 110.0, "damping": 0.8}}
SIZES = {
    "ratio": 0.95, "current": 2e-4, "time": 2.34e-3, "bandwidth": 80.0, "damping": 0.8, "half_width": 2e-4,
    "half_width_negative": 1e-4, "softness": 5e-5, "rate": 0.02, "resistance": 5e9, "time_constant": 0.02,
    "volume_fraction": 0.01, "force": 10.0, "force_positive": 12.0, "force_negative": 8.0, "breakaway_force": 5.0,
    "velocity": 0.01, "stiffness": 3e4, "position": 0.041, "width": 5e-4, "pressure": 5e4, "mass": 0.3,
    "coefficient_positive": 50.0, "coefficient_negative": -20.0, "leakage": 1e-12, "spring": 5e6, "friction": 40.0,
    "valve": 3e-10,
}  # fmt: skip
"""Of parameters; coefficients by the effect's first word. At whole steps of 0.1 ms the dead time has two slopes."""
SENSOR_BANDWIDTH = 20.0
"""Hz: a sensor of 80 Hz is not told from a faster one by runs whose power lies below 10 Hz."""

pytestmark = [pytest.mark.study, pytest.mark.exhaustive, pytest.mark.parametrize("label", CATALOGUE)]


def having(label: str, factor: float = 1.0) -> Bench:
    """A bench with an effect, and what it needs; `factor`: of all sizes, a place moves by a tenth of that."""
    word, *options = label.split()
    names = [one.name for one in CATALOGUE[label].parameters]
    sizes = {name: SIZES[word.split("_")[0] if name == "coefficient" else name] for name in names}
    if word == "sensor_lag":
        sizes["bandwidth"] = SENSOR_BANDWIDTH
    effect = {"id": word, **dict(option.split("=") for option in options), "parameters": sizes}
    effects = [COULOMB, effect] if word == "friction_presliding" else [effect]
    factors = {"position": 1.0 + 0.1 * (factor - 1.0)}
    moved = [
        {**one, "parameters": {name: value * factors.get(name, factor) for name, value in one["parameters"].items()}}
        for one in effects
    ]
    return replace(BENCH, effects=tuple(moved))


def test_learn_finds_its_parameters_from_a_fifth_off(label: str) -> None:
    """On the bench file's own simulation, with sensors' noise: within 5 % or the interval, which must be narrow."""
    truth = having(label)
    result = learn(having(label, 1.2), recordings.split({"run": record(truth)}))
    values = [value for effect in truth.effects for value in parse_entry(effect)[1]]
    for found, value in zip(result.parameters, values, strict=True):
        assert found.informed and found.high - found.low < 0.5 * abs(value), found
        assert abs(found.value - value) < max(0.05 * abs(value), found.high - found.low), found


def test_the_filters_loop_decays_and_follows_its_hidden_states(label: str) -> None:
    """What the filter follows beside a bench with the effect is where that bench is.

    At the lowest gain that a filter certifies: a box that believes in a piston 5 % too large feeds back too much
    velocity, and without friction its loop does not decay from some 16 1/s on, in this linearization and in simulation.
    A dead time has a valve without a lag: beside one of 110 Hz no gain decays from 1.3 ms on.
    """
    bench = having(label)
    if not label.startswith(("valve_lag", "transport_delay")):
        bench = replace(bench, effects=(LAG, *bench.effects))
    loop = make_loop(bench, BENCH)
    assert spectral_radius(closed_loop_at_rest(loop, MetricDesign().gain_low)) < 1.0
    model, memory, rows = BenchModel(bench, substeps=SUBSTEPS), new_memories(), []
    k, y, z = model.begin(model.values)
    currents = 4e-3 * np.sin(2e-3 * np.pi * 3.0 * np.arange(400))
    for current in currents:
        x = np.zeros(8)  # the readings, with rates as they are
        x[[0, 2, 4, 5, 6]] = z
        x[3] = loop["gain"][1] * y[loop["whole.cell_rate"]] if loop["whole.cell_rate"] >= 0 else 0.0
        x[7] = loop["gain"][4] * y[3]
        rows.append(x)
        z = model.sample(k, y, float(current))
    linearize(loop.record, make_samples(np.array(rows), current=currents), memory)
    hidden = memory["hidden"][0, 6 : len(y)]
    scales = np.array([state.scale for state in model.states])[6:]
    np.testing.assert_allclose(hidden / scales, y[6:] / scales, atol=2e-3)
    np.testing.assert_allclose(memory["hidden"][0, :2] / 1e6, y[:2] / 1e6, atol=2e-3)
