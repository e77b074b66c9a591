# SPDX-License-Identifier: Apache-2.0
"""The written-out gradients are those of torch, in double precision."""

from __future__ import annotations

import numpy as np
import pytest

pytest.importorskip("torch")

from hydro_sim.emulator.offline import Segment, record_offline
from hydro_sim.emulator.truth.config import profile
from hydro_sim.files import recordings
from hydro_sim.identification import engines, torch_gradients, training
from hydro_sim.model.bench import Bench
from hydro_sim.neural import mlp, network
from hydro_sim.structured import constants, rollout


def close(one, other, tolerance=1e-8):
    return np.abs(one - other).max() <= tolerance * np.abs(other).max()


@pytest.mark.parametrize("printed", [False, True])
@pytest.mark.parametrize("windows", [3, network.BLOCK + 5])
@pytest.mark.parametrize("hidden", [(32, 32), (6, 5)])
def test_network_gradient_is_that_of_torch(printed, windows, hidden):
    rng = np.random.default_rng(0)
    layers = mlp.layers(mlp.initial(rng, 9, hidden, 8), 9, hidden, 8)
    parts = np.full(8, 0.05), rng.standard_normal((windows, 8)), rng.standard_normal((windows, 12))
    targets = rng.standard_normal((windows, 12, 8))
    loss, gradient = network.loss_and_gradient(layers, *parts, targets, printed, 2)
    expected, expected_gradient = torch_gradients.network_loss(layers, *parts, targets, printed)
    assert loss == pytest.approx(expected, rel=1e-10)
    assert close(gradient, expected_gradient)


def random_start(rng, count):
    """States spread over the working range."""
    spread = np.array([1e6, 1e6, 5e-3, 0.1, 3e-3, 0.5, 100.0, 1000.0, 1e-5])
    center = np.array([6e6, 9.9e6, 0.04, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0])
    return center + spread * rng.standard_normal((count, 9))


def test_structured_gradient_is_that_of_torch():
    rng = np.random.default_rng(1)
    table = constants.constants(Bench.nominal())
    c, _ = constants.values(table, 0.1 * rng.standard_normal(len(table)))
    layers = mlp.layers(mlp.initial(rng, 5, (8, 6), 3), 5, (8, 6), 3)
    center, scale = np.array([6e6, 9.9e6, 0.04, 0.0, 0.0]), np.array([2e6, 2e6, 6e-3, 0.05, 4e-3])
    starts, currents = random_start(rng, 7), 5e-3 * rng.standard_normal((7, 10))
    targets = random_start(rng, 70)[:, [6, 7, 0, 1, 2]].reshape(7, 10, 5)
    weights = 1.0 / np.array([100.0, 100.0, 1e6, 1e6, 1e-2])
    parts = c, layers, center, scale, starts, currents, targets, weights
    loss, by_c, by_network = rollout.loss_and_gradients(*parts, 2)
    expected, expected_c, expected_network = torch_gradients.structured_loss(*parts)
    assert loss == pytest.approx(expected, rel=1e-10)
    learned = np.array([entry.learned for entry in table])
    assert close((by_c * c)[learned], (expected_c * c)[learned])
    assert close(by_network, expected_network)


def test_both_engines_give_the_same_gradients_of_a_training():
    """What `learn` asks an engine for, from the objectives themselves; torch on its CPU stands in for the GPU."""
    recording = record_offline(profile("default"), [Segment(seconds=16.0, amplitude=250.0, frequency=0.9)], seed=5)
    data = recordings.split({"one": recording.states})
    for structure, tolerance in (("network", 1e-4), ("structured", 1e-6)):  # the network computes in float32
        settings = training.Settings(structure=structure, horizon=20, batch=256, stride=50)
        target = training.objective(training.start(data, settings, Bench.nominal()), data, settings)
        parameters = target.model.flat + 0.01 * np.random.default_rng(3).standard_normal(len(target.model.flat))
        target.refresh(parameters)
        results = []
        for one in (engines.CompiledEngine(), engines.TorchEngine("cpu")):
            target.engine = one
            results.append(next(target.gradients(parameters, 0)))
        (loss, gradient), (other_loss, other_gradient) = results
        assert loss == pytest.approx(other_loss, rel=tolerance)
        assert close(gradient, other_gradient, tolerance)
