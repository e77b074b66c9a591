# SPDX-License-Identifier: Apache-2.0
"""Recordings as other programs read them, recordings by other programs, and the repair of damaged ones."""

from __future__ import annotations

import errno
import os
import shutil
import sys
import time
from contextlib import suppress
from pathlib import Path
from struct import pack

import numpy as np
import pytest
import yaml
from mcap.exceptions import EndOfFile
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import ChunkIndex
from mcap.stream_reader import StreamReader
from mcap.writer import Writer as McapWriter
from rosbags.rosbag1 import Writer as Rosbag1Writer
from rosbags.rosbag2 import Reader, StoragePlugin, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from hydro_bridge.bags.cdr import STATE_TOPIC, STATE_TYPE, definition, encode_states
from hydro_bridge.bags.recording import BagWriter, RecordingError, read_bag, stream_bag
from hydro_bridge.bags.repair import repair
from hydro_bridge.nodes.replayer import replay
from hydro_bridge.ros.messages import STATE_CODEC
from tests.checks import ran

GAINS, GAINS_TYPE = "/hydro/gains", "hydro_msgs/msg/Gains"
VERSION_9 = {
    "version", "storage_identifier", "duration", "starting_time", "message_count", "topics_with_message_count",
    "compression_format", "compression_mode", "relative_file_paths", "files", "custom_data", "ros_distro",
}  # fmt: skip
"""Keys of metadata.yaml."""


@pytest.fixture
def states(make_states):
    return make_states(5000)


@pytest.fixture
def bag(tmp_path, states) -> Path:
    """5000 states in five blocks, then 500 Gains: delta_kp = n, delta_ki = -n, step n, epoch n."""
    folder = tmp_path / "run"
    with BagWriter(folder, metadata={"weights": "sha256:1"}, attachments={"bench.yaml": b"stroke: 0.08\n"}) as writer:
        writer.add_topic(GAINS, GAINS_TYPE)
        for piece in np.array_split(states, 5):
            writer.write_states(piece)
            writer.flush()
        for n in range(500):
            header = pack("<4sIII4x", b"\0\1\0\0", 1_700_000_000, 0, 1)
            writer.write(GAINS, header + pack("<ddIxxxxQ", n, -n, n, n), 1_700_000_000 * 10**9 + 10_000_000 * n)
    return folder


def same(read, written) -> bool:
    equal = [np.array_equal(read[name], written[name]) for name in written.dtype.names if name != "time"]
    return all(equal) and np.allclose(read["time"], written["time"], rtol=0, atol=1e-6)


def mcap_of(folder: Path) -> Path:
    (path,) = folder.glob("*.mcap")
    return path


def cut(folder: Path, size: int = -1000) -> Path:
    """Leave the first bytes of a recording's file, as one whose recorder was killed; return its path."""
    path = mcap_of(folder)
    path.write_bytes(path.read_bytes()[:size])
    return path


def contents(folder: Path) -> dict[str, bytes]:
    return {path.name: path.read_bytes() for path in folder.iterdir() if path.is_file()}


def chunks_of(path: Path) -> list[ChunkIndex]:
    with path.open("rb") as stream:
        return sorted(make_reader(stream).get_summary().chunk_indexes, key=lambda one: one.chunk_start_offset)


@pytest.mark.parametrize("single", [False, True], ids=["folder", "file"])
def test_what_was_written_is_read_at_once_and_in_small_pieces(bag, states, single):
    recording = read_bag(mcap_of(bag) if single else bag)
    assert same(recording.state, states)
    assert recording.topics == {STATE_TOPIC: STATE_TYPE, GAINS: GAINS_TYPE}
    assert np.array_equal(recording[GAINS]["delta_ki"], -np.arange(500.0))
    assert recording.metadata["hydro"] == {"weights": "sha256:1"}
    assert recording.attachments == {"bench.yaml": b"stroke: 0.08\n"}
    assert recording.notes == ()
    pieces = list(stream_bag(bag))
    assert len(pieces) >= 5 and max(map(len, pieces)) <= 1000
    assert same(np.concatenate(pieces), states)


@pytest.mark.parametrize("single", [False, True], ids=["folder", "file"])
def test_rosbags_reads_every_message(bag, states, single):
    store, read = get_typestore(Stores.EMPTY), []
    with Reader(mcap_of(bag) if single else bag) as reader:
        for connection in reader.connections:
            types = get_types_from_msg(connection.msgdef.data, connection.msgtype)
            store.register({name: fields for name, fields in types.items() if name not in store.types})
        for connection, _, data in reader.messages():
            message = store.deserialize_cdr(data, connection.msgtype)
            if connection.topic == STATE_TOPIC:
                read.append((message.sequence, message.load_force))
        assert {c.topic: c.msgcount for c in reader.connections} == {STATE_TOPIC: len(states), GAINS: 500}
        if not single:
            hashes = {definition(kind)["type_hash"] for kind in (STATE_TYPE, GAINS_TYPE)}
            assert {c.digest for c in reader.connections} == hashes
    assert read == list(zip(states["sequence"].tolist(), states["load_force"].tolist(), strict=True))


def test_mcap_reads_it_and_every_check_sum_holds(bag, states):
    with mcap_of(bag).open("rb") as stream:
        records = list(StreamReader(stream, validate_crcs=True).records)
        stream.seek(0)
        reader = make_reader(stream)
        summary = reader.get_summary()
        assert reader.get_header().profile == "ros2"
    assert sum(type(record).__name__ == "Message" for record in records) == len(states) + 500
    assert summary.statistics.message_count == len(states) + 500
    assert len(summary.chunk_indexes) >= 5 and all(chunk.message_index_offsets for chunk in summary.chunk_indexes)
    for channel in summary.channels.values():
        schema = summary.schemas[channel.schema_id]
        assert schema.encoding == "ros2msg" and b"=" * 80 + b"\nMSG: std_msgs/Header\n" in schema.data
        assert channel.metadata["topic_type_hash"] == definition(schema.name)["type_hash"]
        assert yaml.safe_load(channel.metadata["offered_qos_profiles"])[0]["history"] == "keep_last"


def test_a_recording_by_rosbags_is_read(tmp_path, states):
    known = definition(STATE_TYPE)
    with Writer(tmp_path / "other", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        connection = writer.add_connection(STATE_TOPIC, STATE_TYPE, msgdef=known["text"], rihs01=known["type_hash"])
        for row, time in zip(encode_states(states), states["time"], strict=True):
            writer.write(connection, int(time * 1e9), row.tobytes())
    assert same(read_bag(tmp_path / "other").state, states)


def test_the_way_to_mcap_that_is_told_is_one(tmp_path):
    kind, ros1, ros2 = "std_msgs/msg/String", get_typestore(Stores.ROS1_NOETIC), get_typestore(Stores.ROS2_JAZZY)
    with Rosbag1Writer(tmp_path / "old.bag") as writer:
        channel = writer.add_connection("/words", kind, typestore=ros1)
        writer.write(channel, 1, ros1.serialize_ros1(ros1.types[kind](data="x"), kind))
    with Writer(tmp_path / "sqlite", version=9, storage_plugin=StoragePlugin.SQLITE3) as writer:
        channel = writer.add_connection("/words", kind, typestore=ros2)
        writer.write(channel, 1, ros2.serialize_cdr(ros2.types[kind](data="x"), kind))
    for path in (tmp_path / "old.bag", tmp_path / "sqlite"):
        with pytest.raises(RecordingError) as refused:
            read_bag(path)
        command = str(refused.value).partition(": ")[2]
        ran(Path(sys.executable).with_name("rosbags-convert"), *command.split()[1:], check=True)
        assert read_bag(command.split()[4]).topics == {"/words": kind}


def test_the_samples_of_a_part_are_those_of_the_whole_and_no_other_chunk_is_unpacked(tmp_path, make_states):
    states = make_states(20_000)
    with BagWriter(tmp_path / "long") as writer:
        writer.write_states(states)
    path = mcap_of(tmp_path / "long")
    for begin, end, asked in ((0, 7_000, ",7"), (7_000, 12_500, "7,12.5"), (12_500, 20_000, "12.5")):
        for whole in (tmp_path / "long", path):
            assert same(read_bag(f"{whole}#t={asked}").state, states[begin:end])
    with pytest.raises(RecordingError, match="no messages on /hydro/state; there is nothing"):
        read_bag(f"{path}#t=20,30", topics=[STATE_TOPIC])
    damaged = bytearray(path.read_bytes())
    damaged[len(damaged) // 2] ^= 255
    path.write_bytes(damaged)
    assert same(read_bag(f"{path}#t=17,").state, states[17_000:]), "what comes before is not unpacked"
    assert same(read_bag(f"{cut(tmp_path / 'long')}#t=0,1").state, states[:1000]), "a torn one has its parts, too"


@pytest.mark.parametrize("keep", [0.3, 0.6, 0.95])
def test_a_recording_cut_off_anywhere_is_read_up_to_there_and_repaired(bag, states, keep):
    size = int(keep * mcap_of(bag).stat().st_size)
    name, before = cut(bag, size).name, read_bag(bag)
    count = len(before.state)
    assert 0 < count <= len(states) and same(before.state, states[:count])
    assert "was not finished" in before.notes[0]
    kept, _ = repair(bag)
    whole = read_bag(bag)
    assert whole.notes == () and same(whole.state, states[:count])
    assert whole.attachments == before.attachments and whole.metadata["hydro"] == before.metadata["hydro"]
    with Reader(bag) as reader:
        assert sum(1 for _ in reader.messages()) == kept
    assert {file.name for file in bag.iterdir()} == {"metadata.yaml", name, "before_repair"}
    assert (bag / "before_repair" / name).stat().st_size == size, "nothing is removed"


def test_a_recording_that_somebody_still_writes_is_not_repaired(bag, tmp_path, states):
    with BagWriter(tmp_path / "now") as writer:
        writer.write_states(states[:1000])
        writer.flush()
        before = contents(tmp_path / "now")
        with pytest.raises(RecordingError, match=f"is open in process {os.getpid()}: end that first"):
            repair(tmp_path / "now")
        assert contents(tmp_path / "now") == before
        writer.write_states(states[1000:])
    assert same(read_bag(tmp_path / "now").state, states)
    assert cut(bag) and repair(bag)[0] > 0


def test_what_a_repair_does_not_read_it_does_not_remove(bag, make_states):
    cut(bag)
    with BagWriter(bag.parent / "other") as writer:
        writer.write_states(make_states(100))
    shutil.copy(writer.path, bag / "other_0.mcap")
    (bag / "notes.txt").write_text("new seal")
    before = contents(bag)
    repair(bag)
    assert {name: contents(bag)[name] for name in ("other_0.mcap", "notes.txt")} == {
        name: before[name] for name in ("other_0.mcap", "notes.txt")
    }
    assert contents(bag / "before_repair") == {name: before[name] for name in ("run_0.mcap", "metadata.yaml")}
    with pytest.raises(RecordingError, match="is whole: there is nothing to repair"):
        repair(bag)


def test_a_repair_that_fails_leaves_all_as_it_was(bag, monkeypatch):
    def full(*_: object) -> None:
        raise OSError(errno.ENOSPC, "No space left on device")

    cut(bag)
    before = contents(bag)
    monkeypatch.setattr("mcap.writer.Writer.add_message", full)
    with pytest.raises(RecordingError, match="No space left on device: nothing was removed"):
        repair(bag)
    assert contents(bag) == before


@pytest.mark.parametrize("chunk", [0, 2])
def test_damage_is_found_and_costs_its_chunk_alone(bag, states, chunk):
    path = mcap_of(bag)
    data, damaged = bytearray(path.read_bytes()), chunks_of(path)[chunk]
    data[damaged.chunk_start_offset + damaged.chunk_length // 2] ^= 0x10
    path.write_bytes(data)
    with pytest.raises(RecordingError, match="is damaged"):
        read_bag(bag)
    rest = read_bag(bag, skip_damaged=True)
    note = f"{path.name} is damaged: 1 of its blocks could not be read"
    assert len(rest.state) == 4000 and rest.notes == (note,)
    assert repair(bag)[1][0] == note
    whole = read_bag(bag)
    assert whole.notes == () and same(whole.state, rest.state)
    assert np.isin(whole.state["sequence"], states["sequence"]).all()
    assert (bag / "before_repair" / path.name).read_bytes() == bytes(data)


def test_behind_a_damaged_length_nothing_is_read_and_nothing_is_removed(bag, states):
    path = mcap_of(bag)
    data = bytearray(path.read_bytes())
    data[chunks_of(path)[2].chunk_start_offset + 8] ^= 0x10
    path.write_bytes(data)
    assert repair(bag)[1][0].startswith(f"{path.name} was not finished")
    assert same(read_bag(bag).state, states[:2000])
    assert (bag / "before_repair" / path.name).read_bytes() == bytes(data)


def test_a_repair_changes_no_definition_no_encoding_and_no_time(tmp_path):
    folder = tmp_path / "theirs"
    folder.mkdir()
    with (folder / "theirs_0.mcap").open("wb") as stream:
        writer = McapWriter(stream)
        writer.start(profile="", library="theirs")
        schema = writer.register_schema("my_pkg/msg/Own", "ros2msg", b"float64 x")
        own = writer.register_channel("/own", "cdr", schema, {"rig": "two"})
        words = writer.register_channel("/words", "json", writer.register_schema("Words", "jsonschema", b"{}"))
        writer.add_metadata("experiment", {"operator": "me"})
        for n in range(50):
            writer.add_message(own, 1000 + n, b"\0\1\0\0" + bytes(8), 500 + n, n + 7)
            writer.add_message(words, 1000 + n, b"{}", 600 + n, n)
        writer.finish()
    path = cut(folder, -20)

    def content() -> list[tuple[object, ...]]:
        found = []
        with path.open("rb") as stream, suppress(EndOfFile):  # where it was cut off
            for schema, channel, message in NonSeekingReader(stream).iter_messages(log_time_order=False):
                described = schema.name, schema.encoding, schema.data, channel.topic, channel.message_encoding
                times = message.log_time, message.publish_time, message.sequence, message.data
                found.append((*described, channel.metadata, *times))
        return sorted(found, key=repr)

    before = content()
    assert repair(folder)[0] == 100 == len(before)
    assert content() == before
    assert read_bag(folder, topics=()).metadata["experiment"] == {"operator": "me"}


def test_a_listed_file_that_is_missing_is_an_error_that_names_it_and_splits_are_in_order(tmp_path, make_states):
    (tmp_path / "day").mkdir()
    pieces = [make_states(50, first=50 * number) for number in range(11)]
    for number, piece in enumerate(pieces):
        with BagWriter(tmp_path / f"{number}") as writer:
            writer.write_states(piece)
        writer.path.rename(tmp_path / f"day/day_{number}.mcap")
    assert same(read_bag(tmp_path / "day").state, np.concatenate(pieces)), "all, in the order of their numbers"

    def listed(*names: str) -> None:
        information = {"storage_identifier": "mcap", "relative_file_paths": [*names]}
        (tmp_path / "day/metadata.yaml").write_text(yaml.safe_dump({"rosbag2_bagfile_information": information}))

    listed("day_0.mcap", "day_1.mcap")
    assert same(read_bag(tmp_path / "day").state, np.concatenate(pieces[:2]))
    listed("day_1.mcap", "gone.mcap")
    with pytest.raises(RecordingError, match=r"lists gone\.mcap, which is missing: put it back, or remove metadata"):
        read_bag(tmp_path / "day")


def test_at_any_time_the_folder_is_a_recording_and_what_was_flushed_is_there(tmp_path, states):
    writer = BagWriter(tmp_path / "now")
    writer.write_states(states[:1000])
    writer.flush()
    writer.write_states(states[1000:1500])  # still in memory
    read = read_bag(tmp_path / "now")
    assert same(read.state, states[:1000]) and read.notes
    information = yaml.safe_load((tmp_path / "now/metadata.yaml").read_text())["rosbag2_bagfile_information"]
    assert set(information) == VERSION_9 and "not finished" in information["custom_data"]["hydro"]
    writer.close()
    assert same(read_bag(tmp_path / "now").state, states[:1500])


def test_what_is_no_recording_or_lacks_the_topic_is_refused_in_one_sentence(tmp_path, bag):
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty.mcap").touch()
    (tmp_path / "text.mcap").write_text("no recording")
    for name, sentence in {
        "nowhere": "does not exist", "empty": "there is no .mcap in it", "empty.mcap": "is empty",
        "text.mcap": "is not an MCAP file",
    }.items():  # fmt: skip
        with pytest.raises(RecordingError, match=sentence):
            read_bag(tmp_path / name)
    with pytest.raises(RecordingError, match=r"no messages on /nothing; there is /hydro/gains, /hydro/state"):
        read_bag(bag, ["/nothing"])
    with pytest.raises(RecordingError, match="no messages on /nothing"):
        list(stream_bag(bag, "/nothing"))


def test_messages_come_at_their_times_freshly_stamped_and_a_jump_of_the_clock_is_not_waited_for(tmp_path, make_states):
    states = make_states(300, first=1000)
    states["time"][200:] -= 3600.0
    with BagWriter(tmp_path / "run") as writer:
        for piece in np.split(states, [200]):
            writer.write_states(piece)
            writer.flush()
    came = []
    for _ in replay(tmp_path / "run", lambda _, data: came.append((time.time(), data)), 4.0):
        time.sleep(1e-3)
    replayed = [STATE_CODEC.unpack(data) for _, data in came]
    assert [state.sequence for state in replayed] == list(range(1000, 1300))
    stamps = 1e-9 * np.array([state.stamp for state in replayed])
    np.testing.assert_allclose(np.delete(np.diff(stamps), 199), 1e-3 / 4.0, atol=2e-6)
    assert stamps[200] - stamps[199] < 1e-6
    late = np.array([at for at, _ in came]) - stamps
    assert np.all(late > -1e-3)
