# SPDX-License-Identifier: Apache-2.0
from __future__ import annotations

import json
import os

import numpy as np
import pytest
from rclpy.serialization import deserialize_message, serialize_message
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hydro_bridge.bags.cdr import SCHEMA_FILE, STATE_TYPE, definition, encode_states, fixed_layout
from hydro_bridge.ros.messages import CORRECTION_CODEC, LAW_STATE_CODEC, STATE_CODEC
from hydro_core.signals import STATE_FIELDS
from tests.schemas import installed_definitions


def test_states_agree_with_an_independent_codec(make_states):
    states, typestore = make_states(5), get_typestore(Stores.EMPTY)
    types = get_types_from_msg(definition(STATE_TYPE)["text"], STATE_TYPE)
    typestore.register({name: fields for name, fields in types.items() if name not in typestore.types})
    for frame_id in ("bench", "", "a", "four", "longer than that"):
        rows = encode_states(states, frame_id)
        for row, state in zip(rows, states, strict=True):
            message = typestore.deserialize_cdr(row.tobytes(), STATE_TYPE)
            assert message.header.frame_id == frame_id
            assert message.sequence == state["sequence"] and message.flags == state["flags"]
            assert [getattr(message, name) for name in STATE_FIELDS] == [state[name] for name in STATE_FIELDS]
            assert bytes(typestore.serialize_cdr(message, STATE_TYPE)) == row.tobytes()
        back = fixed_layout(STATE_TYPE).decode(rows, np.zeros(5, np.int64))
        np.testing.assert_allclose(back["time"], states["time"], atol=1e-6, rtol=0)
        back["time"] = states["time"]
        assert np.array_equal(back, states)


def test_what_is_no_message_of_the_type_is_refused(make_states):
    sound = encode_states(make_states(1))
    xcdr2, long_frame_id = sound.copy(), sound.copy()
    xcdr2[:, 1], long_frame_id[:, 12] = 7, 250
    for rows in (sound[:, :100], xcdr2, long_frame_id):
        with pytest.raises(ValueError, match=r"bytes|CDR"):
            fixed_layout(STATE_TYPE).decode(rows, np.zeros(1, np.int64))


@pytest.mark.skipif("AMENT_PREFIX_PATH" not in os.environ, reason="no ROS environment to compare with")
def test_packaged_definitions_are_those_of_the_installed_messages():
    packaged = json.loads(SCHEMA_FILE.read_text(encoding="utf-8"))
    assert packaged == installed_definitions(), "renew them: python -m tests.schemas"


@pytest.mark.parametrize(
    "codec", [STATE_CODEC, CORRECTION_CODEC, LAW_STATE_CODEC], ids=lambda codec: codec.record.__name__
)
def test_messages_packed_one_by_one_are_those_of_rosidl(codec):
    message, rng = codec.kind(), np.random.default_rng(1)
    for name, kind in list(codec.kind.get_fields_and_field_types().items())[1:]:
        drawn = rng.normal() if kind == "double" else True if kind == "boolean" else int(rng.integers(1, 256))
        setattr(message, name, drawn)
    message.header.stamp.sec, message.header.stamp.nanosec = 1_800_000_000, 999_999_999
    message.header.frame_id = "bench"
    data = serialize_message(message)
    record = codec.unpack(data)
    assert record.stamp == 1_800_000_000_999_999_999
    assert all(getattr(record, name) == getattr(message, name) for name in record._fields[1:])
    assert deserialize_message(codec.pack(*record), codec.kind) == message
    message.header.frame_id = "another frame"
    assert codec.unpack(serialize_message(message)) == record, "of another publisher"
    assert codec.unpack(data[:30]) is None and codec.unpack(b"") is None
