# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from hydro_bridge.serial.protocol import MAX_ENCODED, encode_state
from hydro_bridge.serial.stream import Decoder, SequenceTracker


def wire(sequence: int) -> bytes:
    return encode_state(sequence, 1000 * sequence, [float(sequence)] * 14, 0, 0)


def test_a_stream_without_delimiter_is_counted_once_and_not_kept():
    decoder = Decoder()
    for _ in range(1000):
        assert decoder.feed(b"x" * 1000) == []
        assert len(decoder._pending) <= MAX_ENCODED
    assert decoder.counts.malformed == 1
    assert [frame.sequence for frame in decoder.feed(wire(5))] == [5]


@given(st.lists(st.integers(0, 30), max_size=60))
def test_tracker_delivers_each_number_once_and_in_order(arrivals):
    tracker = SequenceTracker()
    delivered = [n for n in arrivals if tracker.accept(n)]
    assert delivered == sorted(set(delivered))
    counts = tracker.counts
    assert len(delivered) + counts.duplicates + counts.reordered == len(arrivals)
    if delivered:
        assert counts.lost == delivered[-1] - delivered[0] + 1 - len(delivered)


def test_tracker_wraps():
    tracker = SequenceTracker()
    assert all(tracker.accept(n % 2**32) for n in range(2**32 - 5, 2**32 + 5))
    assert tracker.counts.lost == tracker.counts.restarts == 0


def test_tracker_notices_a_restart_of_the_box():
    for before in (5_000, 3_000_000_000):
        tracker = SequenceTracker()
        assert tracker.accept(before) and tracker.accept(0) and tracker.accept(1)
        assert tracker.counts.restarts == 1 and tracker.counts.lost == 0
