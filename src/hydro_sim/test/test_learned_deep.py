# SPDX-License-Identifier: Apache-2.0
"""Networks of any depth, by themselves and on top of the bench's equations: gradients, roll-outs, files, training."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from hydro_sim.emulator.offline import record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.excitation.drawn import draw
from hydro_sim.files import recordings, weights
from hydro_sim.files.weights import WeightsError
from hydro_sim.identification import training
from hydro_sim.learned.model import Learned
from hydro_sim.learned.plant import LearnedPlant
from hydro_sim.learned.region import Region
from hydro_sim.model import equations, hydraulics
from hydro_sim.model.bench import Bench
from hydro_sim.neural import deep
from hydro_sim.neural.deep_model import DeepModel
from hydro_sim.structured.model import StructuredModel

LAGGING = Bench.nominal()
IDEAL = replace(LAGGING, load_cell_bandwidth=None)
HORIZON = 70


@pytest.fixture(scope="module")
def data():
    recording = record_offline(profile("default"), draw(24.0, 5), seed=5)
    return recordings.split({"one": recording.states})


def model(data, bench, hidden=(12, 10, 8), change=0.1):
    """Weights off their start: a network that ends in zeros has no gradient before its last layer."""
    untrained = DeepModel.untrained(data.training, hidden, 0, bench)
    change = change * np.random.default_rng(1).standard_normal(len(untrained.flat))
    return untrained.with_weights(untrained.flat + change)


def windows(data, chosen, count):
    """Normalized starts, currents and targets in double precision."""
    run = data.training[0]
    rows = np.random.default_rng(2).integers(600, len(run) - HORIZON - 1, count)[:, None] + np.arange(HORIZON + 1)
    z, v = (run.x - chosen.center) / chosen.scale, run.u / chosen.current_scale
    return z[rows[:, 0]], v[rows[:, :-1]], z[rows[:, 1:]]


@pytest.mark.parametrize("bench", [None, IDEAL, LAGGING], ids=["alone", "ideal load cell", "amplifier"])
def test_gradient_is_the_slope_of_the_loss(data, bench):
    chosen = model(data, bench)
    parts = chosen.parts._replace(flat=chosen.flat, step=chosen.step.astype(np.float64))
    batch = windows(data, chosen, deep.BLOCK + 6)

    def loss(flat):
        return deep.loss_and_gradient(*parts._replace(flat=flat), *batch, 2)

    _, gradient = loss(chosen.flat)
    for seed in range(3):
        way = np.random.default_rng(seed).standard_normal(len(gradient))
        slope = (loss(chosen.flat + 1e-8 * way)[0] - loss(chosen.flat - 1e-8 * way)[0]) / 2e-8
        assert gradient @ way == pytest.approx(slope, rel=2e-4)


@pytest.mark.parametrize("bench", [IDEAL, LAGGING], ids=["ideal load cell", "amplifier"])
def test_an_untrained_residual_is_the_simulated_bench(data, bench):
    """From a consistent state pressures, position, velocity and load force go where `hydraulics` takes them."""
    chosen = DeepModel.untrained(data.training, (8, 8), 0, bench)
    y, x = hydraulics.rest_state(bench.constants()[0]), np.zeros(8)
    x[4:7] = y[:3]
    x[0] = equations.hydraulic_force(bench, y[0], y[1])
    currents = 3e-3 * np.sin(2 * np.pi * 3.0 * 1e-3 * np.arange(300))
    predicted = chosen.predict(x[None], currents[None])[0]
    for k, current in enumerate(currents):
        hydraulics.advance(bench.constants()[0], y, current, 1e-3, hydraulics.SUBSTEPS)
        assert predicted[k, 4:6] == pytest.approx(y[:2], abs=2e3)
        assert predicted[k, 6] == pytest.approx(y[2], abs=1e-6)
        assert predicted[k, 2] == pytest.approx(y[4], abs=0.05)


@pytest.mark.parametrize(
    ("structure", "hidden", "name"),
    [
        ("network", (8, 8), "network"),
        ("network", (8,), "deep"),
        ("network", (8, 7, 6), "deep"),
        ("residual", (8, 8), "residual"),
    ],
)
def test_layers_of_any_number_are_saved_loaded_and_simulated(data, structure, hidden, name, tmp_path):
    chosen = training.start(data, training.Settings(structure=structure, hidden=hidden), LAGGING)
    assert not isinstance(chosen, StructuredModel) and chosen.name == name
    chosen = chosen.with_weights(chosen.flat + 0.01)
    run = data.training[0]
    Learned(model=chosen, region=Region.about(run.x, run.u)).save(tmp_path / "w.safetensors")
    loaded = Learned.load(tmp_path / "w.safetensors").model
    assert type(loaded) is type(chosen) and loaded.hidden == hidden
    currents = 3e-3 * np.sin(0.02 * np.arange(100))
    expected = chosen.predict(chosen.rest[None], currents[None])[0]
    np.testing.assert_array_equal(loaded.predict(chosen.rest[None], currents[None])[0], expected)
    plant = LearnedPlant(tmp_path / "w.safetensors", noise=0.0)
    plant.reset(0)
    stepped = np.array([plant.step(current) for current in currents])
    assert np.abs((stepped - expected) / chosen.scale).max() < 1e-4


def test_a_file_whose_layers_do_not_fit_is_refused(data, tmp_path):
    run, chosen = data.training[0], DeepModel.untrained(data.training, (8, 7, 6), 0, None)
    header, tensors = chosen.header(), chosen.tensors()
    region = Region.about(run.x, run.u)
    tensors |= {"region_center": region.center, "region_whiten": region.whiten}
    weights.save(tmp_path / "w", tensors, {**header, "hidden": [8, 7]})
    with pytest.raises(WeightsError, match="does not fit its header"):
        Learned.load(tmp_path / "w")
    weights.save(tmp_path / "w", tensors, {**header, "structure": "network"})
    with pytest.raises(WeightsError, match="two hidden layers"):
        Learned.load(tmp_path / "w")
