# SPDX-License-Identifier: Apache-2.0
"""Simulation and emulator behind the bridge are one plant to the graph: same topics, rates, manners."""

from __future__ import annotations

import time
from collections.abc import Iterator
from contextlib import ExitStack
from itertools import pairwise

import numpy as np
import pytest

pytest.importorskip("rclpy")

from rclpy.parameter import parameter_value_to_python
from rclpy.parameter_client import AsyncParameterClient

from hydro_bridge.ros.messages import seconds
from hydro_bridge.ros.topics import CORRECTION, GAINS, REFERENCE, STATE, create_subscription
from hydro_core.signals import CorrectionStatus, Flag, ReferenceSignal, Waveform
from hydro_policy.nodes.plant_options import PlantOptions
from hydro_policy.nodes.plants import GRAPH_FILE, plant_graph, start_nodes
from hydro_policy.task.mdp import GainRange
from tests.domains import own_domain
from tests.graph_probe import Probe

pytestmark = [pytest.mark.graph, pytest.mark.realtime]

STALE = 0.15
"""s between two gains of this test, from which on they may be stale to a plant (after 0.2 s), rightly."""


@pytest.fixture(scope="module", params=["sim", "emulator"])
def probe(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Probe]:
    with ExitStack() as stack:
        stack.enter_context(own_domain())
        folder = tmp_path_factory.mktemp("graph")
        graph = plant_graph(PlantOptions(plant=request.param, pace="real"), GainRange(), folder)
        start_nodes(stack, folder / GRAPH_FILE, graph, print)
        watcher = Probe()
        watcher.graph = graph
        stack.callback(watcher.close)
        watcher.wait(lambda: len(watcher.heard[STATE]) > 100)
        watcher.wait(lambda: watcher.node.count_publishers(CORRECTION) == 1)  # the filter compiles first
        watcher.take()
        watcher.wait(lambda: all(watcher.node.count_subscribers(topic) for topic in (GAINS, REFERENCE)))
        watcher.spin(1.0)
        yield watcher


def test_ros2_param_shows_what_the_graphs_file_says(probe: Probe) -> None:
    for name, values in probe.graph.items():
        if name == "emulator":  # like the box itself, it knows no ROS
            continue
        answer = AsyncParameterClient(probe.node, name).get_parameters(list(values))
        probe.wait(answer.done)
        shown = [parameter_value_to_python(value) for value in answer.result().values]
        assert dict(zip(values, shown, strict=True)) == values


def test_disarmed_the_valve_is_still_and_armed_it_follows_the_reference_with_the_gains_asked_for(probe: Probe) -> None:
    assert not probe.flags() & Flag.ARMED
    assert probe.last(STATE).valve_current == 0.0
    probe.arm(False)
    probe.commander.publish_reference(ReferenceSignal(waveform=Waveform.SINE, amplitude=200.0, frequency=1.0))
    probe.arm(True)
    probe.drive(75.0, 10.0, 2.5)
    for _ in range(5):  # a machine that holds gains up gets base gains, rightly: then once more
        probe.forget()
        longest = probe.drive(75.0, 10.0, 1.0)
        states = probe.states
        held = Flag.WATCHDOG | Flag.FILTER_STALE
        applied = {(m.proportional_gain, m.integral_gain) for m in states if not m.flags & held}
        if longest < STALE and applied == {(90.0, 15.0)}:
            break
        assert applied <= {(90.0, 15.0), (15.0, 5.0)}, "the gains asked for or the base gains, and no others"
    else:
        pytest.fail(f"five times other gains than those asked for, or stale ones: {applied}, {longest:.2f} s")
    reference = np.array([m.reference_force for m in states])
    error = reference - np.array([m.load_force for m in states])
    assert np.abs(reference).max() == pytest.approx(200.0, rel=0.02)
    assert np.sqrt(np.mean(error**2)) < 40.0, "a fifth of the amplitude"
    probe.arm(False)
    probe.spin(0.2)
    assert probe.last(STATE).valve_current == 0.0


def test_samples_come_at_1_khz_in_order_with_the_time_of_now_and_each_is_answered_once(probe: Probe) -> None:
    def told_by_the_filter() -> tuple[int, int]:
        """Answers, and samples that never reached it."""
        said = probe.told["filter"]
        return sum(int(said[each.name.lower()]) for each in CorrectionStatus), int(said["missing_states"])

    answered: list[int] = []
    create_subscription(probe.node, CORRECTION, lambda message: answered.append(message.sequence))
    probe.wait(lambda: probe.told["filter"])
    answers, missed = told_by_the_filter()
    probe.forget()
    probe.wait(lambda: told_by_the_filter()[0] > answers + 2000)
    states = probe.states
    sequences = np.array([message.sequence for message in states], np.int64)
    stamps = np.array([seconds(message.header.stamp) for message in states])
    assert (np.diff(sequences) > 0).all() and (np.diff(stamps) > 0).all()
    rate = (sequences[-1] - sequences[0]) / (stamps[-1] - stamps[0])
    assert rate == pytest.approx(1000.0, rel=0.02)
    assert abs(time.time() - stamps[-1]) < 1.0
    assert {message.header.frame_id for message in states} == {"bench"}
    assert all(later > earlier for earlier, later in pairwise(answered))
    all_answers, all_missed = told_by_the_filter()
    assert all_missed - missed < 0.05 * (all_answers - answers), "/hydro/state is best effort"
