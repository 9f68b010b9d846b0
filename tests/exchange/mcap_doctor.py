"""What ``mcap doctor --strict-message-order`` checks of a file, with the records of the Python library.

The command is written in Go and is on no registry that the tests reach; what it checks is done again here: each record
parses, schemas and channels are there before they are used and stand in the summary as well, checksums, sizes and times
of chunks, the index of messages and of chunks, the statistics, and that no message is earlier than the one before.
"""

from __future__ import annotations

import io
import zlib
from collections import Counter
from pathlib import Path

from mcap.data_stream import ReadDataStream
from mcap.opcode import Opcode
from mcap.records import (
    Channel,
    Chunk,
    ChunkIndex,
    DataEnd,
    Footer,
    Header,
    McapRecord,
    Message,
    MessageIndex,
    Schema,
    Statistics,
)
from mcap.stream_reader import StreamReader, get_chunk_data_stream


class Doctor:
    """Faults of an MCAP file; `faults` is empty for a sound one."""

    def __init__(self, path: Path) -> None:
        self.faults: list[str] = []
        self.data: dict[type, dict[int, Schema | Channel]] = {Schema: {}, Channel: {}}
        self.summary: dict[type, dict[int, Schema | Channel]] = {Schema: {}, Channel: {}}
        self.in_summary = False
        self.counts: Counter[int] = Counter()
        self.times: list[int] = []
        self.chunks: dict[int, Chunk] = {}
        self.used: dict[int, set[int]] = {}
        self.indexes: dict[int, ChunkIndex] = {}
        self.statistics: list[Statistics] = []
        self.raw = path.read_bytes()
        self.examine(path)

    def expect(self, holds: object, fault: str) -> None:
        if not holds:
            self.faults.append(fault)

    def examine(self, path: Path) -> None:
        chunk: tuple[int, Chunk] | None = None
        found: dict[int, MessageIndex] = {}
        last: list[type] = []
        with open(path, "rb") as stream:
            reader = StreamReader(stream, emit_chunks=True, validate_crcs=True)
            begin = 8
            for record in reader.records:
                if chunk is not None and not isinstance(record, MessageIndex):
                    self.chunk(*chunk, found)
                    chunk, found = None, {}
                match record:
                    case Header():
                        self.expect(record.library, "the header names no library")
                        self.expect(record.profile in ("", "ros1", "ros2"), f"profile {record.profile}")
                    case Schema() | Channel():
                        self.described(record)
                    case Message():
                        self.expect(False, "a message outside of chunks")
                    case Chunk():
                        chunk = begin, record
                    case MessageIndex():
                        self.expect(chunk is not None, "an index of messages without a chunk before it")
                        self.expect(record.channel_id not in found, f"two indexes of channel {record.channel_id}")
                        found[record.channel_id] = record
                    case ChunkIndex():
                        self.expect(record.chunk_start_offset not in self.indexes, "two indexes of a chunk")
                        self.indexes[record.chunk_start_offset] = record
                    case Statistics():
                        self.statistics.append(record)
                    case DataEnd():
                        self.in_summary = True
                last.append(type(record))
                begin = reader._stream.count
        self.expect(
            last[0] is Header and DataEnd in last and last[-1] is Footer, "header, data end or footer is missing"
        )
        self.footer(begin)
        self.indexed()
        self.counted()

    def described(self, record: Schema | Channel) -> None:
        kind, before = type(record), self.data[type(record)].get(record.id)
        if isinstance(record, Schema):
            self.expect(record.id != 0, "schema 0 is reserved")
            self.expect(record.encoding, f"schema {record.id} has no encoding")
        else:
            self.expect(record.schema_id in self.data[Schema], f"channel {record.id} has no schema before it")
        if self.in_summary:
            self.expect(before == record, f"{kind.__name__} {record.id} of the summary is not that of the data")
            self.summary[kind][record.id] = record
        else:
            self.expect(before is None, f"{kind.__name__} {record.id} stands twice")
            self.data[kind][record.id] = record

    def chunk(self, begin: int, chunk: Chunk, found: dict[int, MessageIndex]) -> None:
        stream, length = get_chunk_data_stream(chunk, validate_crc=True)
        self.expect(length == chunk.uncompressed_size, f"size of the chunk at {begin}")
        self.expect(chunk.uncompressed_crc, f"the chunk at {begin} has no checksum")
        places = {channel: {offset: time for time, offset in index.records} for channel, index in found.items()}
        times = []
        while stream.count < length:
            at = stream.count
            record = self.inner(stream)
            if isinstance(record, (Schema, Channel)):
                self.described(record)
            elif isinstance(record, Message):
                self.expect(record.channel_id in self.data[Channel], f"a message of no channel, {record.channel_id}")
                self.expect(
                    places.get(record.channel_id, {}).get(at) == record.log_time,
                    f"the index of channel {record.channel_id} does not have the message at {at}",
                )
                latest = max([*self.times[-1:], *times[-1:]], default=0)
                self.expect(record.log_time >= latest, f"a message at {record.log_time} after one at {latest}")
                times.append(record.log_time)
                self.counts[record.channel_id] += 1
                self.used.setdefault(begin, set()).add(record.channel_id)
            else:
                self.expect(False, "a record that does not belong into a chunk")
        if times:
            span = (chunk.message_start_time, chunk.message_end_time)
            self.expect(span == (min(times), max(times)), f"times of the chunk at {begin}: {span}")
        self.expect(
            sum(map(len, places.values())) == len(times), f"the chunk at {begin} has other messages than indexed"
        )
        self.times += times
        self.chunks[begin] = chunk

    @staticmethod
    def inner(stream: ReadDataStream) -> McapRecord | None:
        opcode, length = stream.read1(), stream.read8()
        match opcode:
            case Opcode.SCHEMA:
                return Schema.read(stream)
            case Opcode.CHANNEL:
                return Channel.read(stream)
            case Opcode.MESSAGE:
                return Message.read(stream, length)
        stream.read(length)
        return None

    def footer(self, end: int) -> None:
        footer = Footer.read(ReadDataStream(io.BytesIO(self.raw[-28:-8])))
        self.expect(0 < footer.summary_start < end, "the footer knows no summary")
        self.expect(footer.summary_start <= footer.summary_offset_start < end, "the footer's summary offsets")
        covered = self.raw[footer.summary_start : len(self.raw) - 8 - 4]
        self.expect(footer.summary_crc == zlib.crc32(covered), "checksum of the summary")

    def indexed(self) -> None:
        self.expect(set(self.indexes) == set(self.chunks), "chunks and their indexes are not the same")
        for begin, index in self.indexes.items():
            if (chunk := self.chunks.get(begin)) is None:
                continue
            length = 9 + int.from_bytes(self.raw[begin + 1 : begin + 9], "little")
            told = (index.message_start_time, index.message_end_time, index.compression, index.compressed_size)
            true = (chunk.message_start_time, chunk.message_end_time, chunk.compression, len(chunk.data))
            self.expect(told == true and index.chunk_length == length, f"index of the chunk at {begin}")
            self.expect(index.uncompressed_size == chunk.uncompressed_size, f"size in the index of {begin}")
            for channel in self.used.get(begin, ()):
                self.expect(channel in self.summary[Channel], f"channel {channel} is not in the summary")
                schema = self.data[Channel][channel].schema_id  # type: ignore[union-attr]
                self.expect(schema in self.summary[Schema], f"schema {schema} is not in the summary")
                at = index.message_index_offsets.get(channel, 0)
                self.expect(self.raw[at] == Opcode.MESSAGE_INDEX, f"offset of the messages of channel {channel}")

    def counted(self) -> None:
        self.expect(len(self.statistics) == 1, f"{len(self.statistics)} records of statistics")
        for one in self.statistics:
            span = (one.message_start_time, one.message_end_time)
            self.expect(span == (min(self.times), max(self.times)), "times in the statistics")
            self.expect(one.message_count == len(self.times), "messages in the statistics")
            self.expect(dict(one.channel_message_counts) == dict(self.counts), "messages of each channel")
            numbers = (one.schema_count, one.channel_count, one.chunk_count)
            there = (len(self.data[Schema]), len(self.data[Channel]), len(self.chunks))
            self.expect(numbers == there, f"schemas, channels and chunks: {numbers}, there are {there}")
