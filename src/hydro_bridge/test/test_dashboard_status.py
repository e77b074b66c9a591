# SPDX-License-Identifier: Apache-2.0
"""What the page is told: the right columns in its units, a bounded curve, the latest word of each node."""

from __future__ import annotations

import numpy as np
import pytest

from hydro_bridge.bags.cdr import encode_states
from hydro_bridge.dashboard.series import STATE_TYPE, Decoder, described, state_values
from hydro_bridge.dashboard.status import Curve
from hydro_bridge.signals import STATE_DTYPE, Flag


def test_samples_become_the_columns_that_the_page_is_told_of() -> None:
    states = np.zeros(3, STATE_DTYPE)
    states["time"] = [5.0, 5.001, 5.002]
    states["reference_force"], states["load_force"] = 100.0, [90.0, 100.0, 120.0]
    states["valve_current"], states["pressure_a"], states["piston_position"] = 0.012, 5e6, 0.034
    states["flags"] = [0, Flag.ARMED, Flag.TRIPPED | Flag.FORCE_LIMIT]
    table = Decoder(STATE_TYPE).table([row.tobytes() for row in encode_states(states)])
    names = [column["name"] for column in described()[0]]
    values = dict(zip(names, state_values(table).T, strict=True))
    np.testing.assert_allclose(values["error"], [10.0, 0.0, -20.0])
    assert values["armed"].tolist() == [0.0, 1.0, 0.0] and values["tripped"].tolist() == [0.0, 0.0, 1.0]
    assert values["current"][0] == pytest.approx(12.0), "mA"
    assert values["pressure a"][0] == pytest.approx(50.0), "bar"
    assert values["position"][0] == pytest.approx(34.0), "mm"
    np.testing.assert_allclose(table["time"], states["time"])


def test_the_learning_curve_has_each_finished_episode_once_and_the_last_one_too() -> None:
    training, evaluating, paused, finished = 1, 2, 3, 4
    curve = Curve()
    for phase, episode, rmse in (
        (evaluating, 0, np.nan), (training, 1, np.nan), (training, 1, np.nan), (training, 2, 9.0), (paused, 2, 9.0),
        (training, 2, 9.0), (evaluating, 2, 7.0), (training, 3, 7.0), (evaluating, 3, 5.0), (finished, 3, 5.0),
    ):  # fmt: skip
        curve.add(phase, episode, rmse, -rmse)
    assert curve.content() == {"episode": [1, 2, 3], "rmse": [9.0, 7.0, 5.0], "return": [-9.0, -7.0, -5.0]}
    curve.add(training, 2, 4.0, -4.0)  # another run
    assert curve.content()["episode"] == [1]
