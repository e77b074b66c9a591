# SPDX-License-Identifier: Apache-2.0
"""Repair of a recording whose recorder was killed, or that is damaged: `recorder --repair FOLDER`.

Each file is copied record by record, with the definitions, channels, times, metadata and attachments of its writer.
Unreadable parts are skipped and reported. The copies are read back and counted before they replace the files, which
are moved to a sub-folder: a repair removes nothing. A recording in progress is refused: our recorder holds a lock on
its file (`try_lock`), another recorder has it open.
"""

from __future__ import annotations

import os
import shutil
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import ExitStack, contextmanager, suppress
from dataclasses import dataclass, field, replace
from pathlib import Path

import yaml
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer

from hydro_bridge.bags.storage import MESSAGE_HEAD, MIXED_FILES_NOTE, McapScan, listed_topics, mcap_files
from hydro_bridge.bags.types import RecordingError
from hydro_bridge.bags.writer import TopicEntry, bag_metadata, try_lock

BACKUP_FOLDER = "before_repair"
"""Sub-folder that keeps the original files."""
_RECENT_TIME, _GROWTH_WATCH_TIME = 10.0, 1.5
"""s since the last write within which a file is watched for growth, and duration of that."""


@dataclass
class CopiedFile:
    """Statistics of the readable part of one file while it is copied."""

    path: Path
    topics: dict[str, TopicEntry] = field(default_factory=dict)
    count: int = 0
    """Number of messages."""
    span: tuple[int, int] = (2**63 - 1, 0)
    """Log times of first and last message [ns]."""
    missing: list[str] = field(default_factory=list)
    """Sentences on unreadable parts."""
    custom: dict[str, str] = field(default_factory=dict)
    """Metadata record `hydro`."""


def repair(folder: Path | str) -> tuple[int, list[str]]:
    """Repair a recording in place: copy what is readable and write indexes and metadata.yaml.

    Returns
    -------
    Number of messages copied, and sentences on missing parts and on the folder of the original files.

    Raises
    ------
    RecordingError
        The folder is no recording, or undamaged; it is being written, has files that metadata.yaml does not list or
        files of several recordings, no message can be read, or there is no room. No data is removed then.
    """
    folder = Path(folder).resolve()
    if folder.is_file():
        raise RecordingError(f"{folder} is a file: name the folder of the recording, with its .mcap alone in it")
    files, notes = mcap_files(folder)
    if any(MIXED_FILES_NOTE in note for note in notes):
        raise RecordingError(f"{folder} holds files of several recordings: move each into a folder of its own first")
    if strange := sorted(path.name for path in set(folder.glob("*.mcap")) - set(files)):
        raise RecordingError(
            f"{folder} holds {', '.join(strange)}, of which its metadata.yaml says nothing: move that elsewhere first"
        )
    with ExitStack() as stack:
        for path in files:
            stack.enter_context(_at_rest(path))
        scratch = folder / f".repair_{os.getpid()}"
        stack.callback(shutil.rmtree, scratch, ignore_errors=True)
        try:
            scratch.mkdir()
            copies = [_copied(path, scratch / path.name, listed_topics(folder)) for path in files]
            if not notes and all(copy.missing == [] for copy in copies):
                raise RecordingError(f"{folder} is whole: there is nothing to repair")
            if not (count := sum(copy.count for copy in copies)):
                raise RecordingError(f"{folder}: no message can be read: nothing was changed")
            _write_metadata(scratch, copies)
            before = next(
                path
                for n in range(1, 10**6)
                if not (path := folder / (BACKUP_FOLDER if n == 1 else f"{BACKUP_FOLDER}_{n}")).exists()
            )
            before.mkdir()
            for path in (*files, folder / "metadata.yaml"):
                if path.exists():
                    os.replace(path, before / path.name)
            for path in sorted(scratch.iterdir()):
                os.replace(path, folder / path.name)
        except OSError as error:
            raise RecordingError(f"{folder} cannot be repaired: {error.strerror}: nothing was removed") from None
    missing = [f"{copy.path.name}: {sentence}" for copy in copies for sentence in copy.missing]
    return count, [*missing, f"the files as they were are in {before}: remove them once the new ones are what you want"]


def _copied(path: Path, target: Path, listed: list[tuple[str, str]]) -> CopiedFile:
    """Copy one file record by record, and check that all is there; `listed`: topics and types of metadata.yaml."""
    copy, scan = CopiedFile(target), McapScan(path, skip_damaged=True)
    schemas: dict[int, int] = {}
    channels: dict[int, int] = {}
    unknown: Counter[int] = Counter()
    with target.open("wb") as stream:
        writer = Writer(stream, compression=CompressionType.ZSTD, enable_data_crcs=True)
        writer.start(profile="ros2", library="hydro_bridge, repaired")
        for block, spans in scan.blocks():
            starts = sorted(
                (start, size, number)
                for number, span in spans.items()
                for start, size in zip(span.starts.tolist(), span.sizes.tolist(), strict=True)
            )
            for start, size, number in starts:
                if number not in scan.channels and scan.from_this_package:
                    scan.add_channel(number, listed)
                if number not in scan.channels:
                    unknown[number] += 1
                    continue
                channel = scan.channels[number]
                if number not in channels:
                    schema = scan.schemas.get(channel.schema_id)
                    if schema is not None and channel.schema_id not in schemas:
                        schemas[channel.schema_id] = writer.register_schema(schema.name, schema.encoding, schema.data)
                    schema_id = schemas.get(channel.schema_id, 0)
                    channels[number] = writer.register_channel(
                        channel.topic, channel.message_encoding, schema_id, channel.metadata
                    )
                    copy.topics.setdefault(channel.topic, TopicEntry.of_channel(channel, schema))
                _, sequence, log_time, publish_time = MESSAGE_HEAD.unpack_from(block, start - MESSAGE_HEAD.size)
                data = block[start : start + size]
                writer.add_message(channels[number], log_time, data, publish_time, sequence)
                copy.topics[channel.topic].count += 1
                copy.count += 1
                copy.span = (min(copy.span[0], log_time), max(copy.span[1], log_time))
        for name, data in scan.attachments.items():
            writer.add_attachment(0, 0, name, "", data)
        for name, record in scan.metadata.items():
            if name != "rosbag2":  # of the file as it was
                writer.add_metadata(name, record)
        writer.finish()  # type: ignore[no-untyped-call]
        stream.flush()
        os.fsync(stream.fileno())
    copy.custom, lost = scan.metadata.get("hydro", {}), sum(unknown.values())
    said = {
        f"{scan.damaged} damaged blocks are left out": scan.damaged,
        f"{lost} messages are left out whose channels nothing describes": lost,
        f"{scan.unread} bytes could not be read": scan.unread,
    }
    copy.missing = [sentence for sentence, count in said.items() if count]
    if not (scan.finished or copy.missing):
        copy.missing = ["it has no index"]
    with target.open("rb") as stream:
        there = Counter(channel.topic for _, channel, _ in make_reader(stream).iter_messages())
    if there != Counter({name: topic.count for name, topic in copy.topics.items()}):
        raise RecordingError(f"{path}: not all that was read came back from the new file: nothing was changed")
    return copy


def _write_metadata(scratch: Path, copies: list[CopiedFile]) -> None:
    topics: dict[str, TopicEntry] = {}
    for copy in copies:
        for name, topic in copy.topics.items():
            count = topics[name].count if name in topics else 0
            topics[name] = replace(topic, count=count + topic.count)
    said = "; ".join(sentence for copy in copies for sentence in copy.missing) or "metadata.yaml"
    custom = {**{key: value for copy in copies for key, value in copy.custom.items()}, "repaired": said}
    content = bag_metadata(topics, [(copy.path.name, *copy.span, copy.count) for copy in copies], custom)
    text = yaml.safe_dump({"rosbag2_bagfile_information": content}, sort_keys=False)
    (scratch / "metadata.yaml").write_text(text, encoding="utf-8")


@contextmanager
def _at_rest(path: Path) -> Iterator[None]:
    """Hold the lock of a file that nobody writes; raises RecordingError."""
    with path.open("rb") as file:
        if not try_lock(file):
            raise RecordingError(f"{path} is being written by a recorder: end that first")
        wanted = path.stat()
        for entry in Path("/proc").glob("[0-9]*/fd/*"):  # of the processes that this user may inspect
            with suppress(OSError, ValueError, IndexError):
                found = entry.stat()
                if (found.st_dev, found.st_ino) == (wanted.st_dev, wanted.st_ino):
                    flags = (entry.parent.parent / "fdinfo" / entry.name).read_text().split("flags:")[1].split()[0]
                    if int(flags, 8) & (os.O_WRONLY | os.O_RDWR):
                        writer = entry.parent.parent.name
                        raise RecordingError(f"{path} is open for writing in process {writer}: end that first")
        before = path.stat()
        if time.time() - before.st_mtime < _RECENT_TIME:  # perhaps written from another machine
            time.sleep(_GROWTH_WATCH_TIME)
            if path.stat().st_size != before.st_size:
                raise RecordingError(f"{path} grows: end the recorder that writes it first")
        yield
