# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import time

import numpy as np
import pytest

from hydro_bridge.bags.recording import STATE_TOPIC, BagWriter
from hydro_bridge.bags.writer import sequence_of
from hydro_bridge.nodes.replayer import Replay


@pytest.fixture
def bag(tmp_path, make_states):
    with BagWriter(tmp_path / "run") as writer:
        writer.write_states(make_states(300, first=1000))
    return tmp_path / "run"


def stamp(data: bytes) -> float:
    sec, nanosec = np.frombuffer(data[4:12], "<u4")
    return float(sec) + 1e-9 * float(nanosec)


def replayed(bag, speed):
    """(stamp, arrival) [s] of each message, shape (n, 2)."""
    came: list[tuple[float, bytes]] = []
    Replay(bag, [STATE_TOPIC], lambda _, data: came.append((time.time(), data)), speed=speed).run()
    assert [sequence_of(data) for _, data in came] == list(range(1000, 1300))
    return np.array([(stamp(data), at) for at, data in came])


@pytest.mark.parametrize("speed", [1.0, 4.0])
def test_messages_come_at_their_times_freshly_stamped(bag, speed):
    late = []
    while len(late) < 5 and min(late, default=1.0) >= 0.02:  # anew where the machine was busy with something else
        stamps, arrivals = replayed(bag, speed).T
        np.testing.assert_allclose(np.diff(stamps), 1e-3 / speed, atol=2e-6)
        assert np.all(arrivals - stamps > -1e-3)
        late.append(np.median(arrivals - stamps))
    assert min(late) < 0.02
