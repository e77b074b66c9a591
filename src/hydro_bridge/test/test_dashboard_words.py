# SPDX-License-Identifier: Apache-2.0
"""What the page is told: the right columns in its units, a bounded curve, the latest word of each node."""

from __future__ import annotations

import json

import numpy as np
import pytest

from hydro_bridge.bags.cdr import encode_states
from hydro_bridge.dashboard import words
from hydro_bridge.dashboard.series import STATE_TYPE, Decoder, described, state_values
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


def test_a_message_of_another_length_does_not_spoil_the_others() -> None:
    rows = [row.tobytes() for row in encode_states(np.zeros(2, STATE_DTYPE))]
    assert len(Decoder(STATE_TYPE).table([rows[0] + b"1234", *rows])) == 2


def test_the_curve_is_bounded_and_keeps_its_newest_episode() -> None:
    curve = words.Curve()
    for episode in range(10_000):
        for _ in range(2):  # each is told of many times
            curve.add(episode, 100.0 / (1 + episode), -float(episode))
    told = curve.content()
    assert len(told["episode"]) == len(told["rmse"]) == len(told["return"]) <= words.CURVE
    assert told["episode"][-1] == 9999 and told["episode"] == sorted(set(told["episode"]))


def test_another_run_begins_another_curve() -> None:
    curve = words.Curve()
    for episode in (0, 1, 2, 0, 1):
        curve.add(episode, 10.0 + episode, 0.0)
    assert curve.content()["episode"] == [1] and curve.content()["rmse"] == [11.0]


def test_nodes_are_bounded_and_those_heard_last_stay() -> None:
    nodes = words.Nodes()
    for number in range(1000):
        nodes.hear(f"node{number}", 0, "", {str(key): "" for key in range(500)}, float(number))
    told = nodes.content(1000.0)
    assert len(told) == words.NODES and {one["name"] for one in told} == {f"node{n}" for n in range(968, 1000)}
    assert all(len(one["values"]) == words.VALUES for one in told)
    assert min(one["age"] for one in told) == 1.0


def test_decisions_are_counted_since_the_last_look_and_unknown_ones_are_no_matter() -> None:
    decided = words.FilterCounts()
    decided.add({0: 400, 1: 3, 99: 5})
    decided.add({0: 97})
    assert decided.take() == {"pass": 497, "modified": 3}
    assert decided.take() == {}


def test_what_is_not_finite_is_null_for_javascript() -> None:
    assert json.loads(words.encoded("words", {"rmse": float("nan")})) == {"kind": "words", "rmse": None}
