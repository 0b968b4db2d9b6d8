"""MCAP writer with a fast path for messages, after the format's specification (mcap.dev/spec).

The `mcap` package writes a message in a dozen small steps, which at the rates of a cell is half of
the recorder's CPU budget; here it is one. All other records are written by that package.
"""

import struct
import zlib
from collections import defaultdict
from collections.abc import Sequence
from typing import Any, BinaryIO

import zstandard
from mcap import records
from mcap.data_stream import RecordBuilder
from mcap.opcode import Opcode

MAGIC = b"\x89MCAP0\r\n"
MESSAGE = struct.Struct("<BQHIQQ")  # opcode, length, channel, sequence, log time, publish time
MESSAGE_OPCODE = int(Opcode.MESSAGE)
MESSAGE_HEAD_B = MESSAGE.size - 9  # counted in its length, before the data
LEVEL = 1  # of zstd: higher levels cost more and do not compress this data further
MESSAGE_INDEX = struct.Struct("<BQHI")  # opcode, length, channel, bytes of its entries
FOOTER_HEAD = struct.Struct("<BQQQ")
FOOTER_B = 8 + 8 + 4


class McapWriter:
    """Writer of one file. Flushed data remain readable after any failure."""

    def __init__(self, stream: BinaryIO, library: str) -> None:
        """Write magic and header of a file."""
        self.bytes = 0
        self._stream = stream
        self._body: list[bytes] = []  # of the open chunk
        self.waiting_B = 0  # of the open chunk, before compression
        self._times: dict[int, list[int]] = defaultdict(list)  # channel: time, offset, time, ...
        self._schemas: list[records.Schema] = []
        self._channels: list[records.Channel] = []
        self._counts: dict[int, int] = defaultdict(int)
        self._chunks: list[records.ChunkIndex] = []
        self._attached: list[records.AttachmentIndex] = []
        self._metadata: list[records.MetadataIndex] = []
        self._write(MAGIC)
        self._put(records.Header(profile="", library=library))

    def add_channel(
        self, topic: str, encoding: str, schema: tuple[str, str, bytes], **metadata: str
    ) -> int:
        """Write a channel with name, encoding and data of its schema; return its id."""
        name, kind, text = schema
        made = records.Schema(id=len(self._schemas) + 1, name=name, encoding=kind, data=text)
        self._schemas.append(made)
        self._put(made)
        channel = records.Channel(
            id=len(self._channels) + 1,
            topic=topic,
            message_encoding=encoding,
            schema_id=made.id,
            metadata=metadata,
        )
        self._channels.append(channel)
        self._put(channel)
        return channel.id

    def add(self, channel: int, log_ns: int, data: bytes, sequence: int) -> None:
        """Add a message to the open chunk."""
        size = len(data)
        head = MESSAGE.pack(
            MESSAGE_OPCODE, MESSAGE_HEAD_B + size, channel, sequence, log_ns, log_ns
        )
        self._times[channel] += (log_ns, self.waiting_B)
        self._body += (head, data)
        self.waiting_B += MESSAGE.size + size

    def add_metadata(self, name: str, data: dict[str, str]) -> None:
        """Write a metadata record."""
        offset, length = self._put(records.Metadata(name=name, metadata=data))
        self._metadata.append(records.MetadataIndex(offset=offset, length=length, name=name))

    def add_attachment(self, name: str, media_type: str, data: bytes, at_ns: int) -> None:
        """Write an attachment."""
        about: dict[str, Any] = {
            "create_time": at_ns, "log_time": at_ns, "name": name, "media_type": media_type,
        }  # fmt: skip
        offset, length = self._put(records.Attachment(**about, data=data))
        index = records.AttachmentIndex(**about, offset=offset, length=length, data_size=len(data))
        self._attached.append(index)

    def flush(self) -> None:
        """Write the open chunk: its messages are then in the file, also after a kill."""
        if self._body:
            self._write_chunk()
        self._stream.flush()

    def finish(self) -> None:
        """Write the open chunk and the summary section for random access."""
        self.flush()
        self._put(records.DataEnd(data_section_crc=0))
        start = self.bytes
        summary = RecordBuilder()
        offsets = []
        groups: dict[Opcode, Sequence[records.McapRecord]] = {
            Opcode.SCHEMA: self._schemas,
            Opcode.CHANNEL: self._channels,
            Opcode.STATISTICS: [self._statistics()],
            Opcode.CHUNK_INDEX: self._chunks,
            Opcode.ATTACHMENT_INDEX: self._attached,
            Opcode.METADATA_INDEX: self._metadata,
        }
        for opcode, group in groups.items():
            begin = summary.count
            for record in group:
                record.write(summary)
            if group:
                offsets.append(
                    records.SummaryOffset(
                        group_opcode=opcode,
                        group_start=start + begin,
                        group_length=summary.count - begin,
                    )
                )
        offsets_start = start + summary.count
        for offset in offsets:
            offset.write(summary)
        text = summary.end()
        head = FOOTER_HEAD.pack(Opcode.FOOTER, FOOTER_B, start, offsets_start)
        self._write(text)
        self._put(
            records.Footer(
                summary_start=start,
                summary_offset_start=offsets_start,
                summary_crc=zlib.crc32(head, zlib.crc32(text)),
            )
        )
        self._write(MAGIC)
        self._stream.flush()

    def _write_chunk(self) -> None:
        body = b"".join(self._body)
        about: dict[str, Any] = {
            "compression": "zstd",
            "message_start_time": min(min(times[::2]) for times in self._times.values()),
            "message_end_time": max(max(times[::2]) for times in self._times.values()),
            "uncompressed_size": len(body),
        }
        data = zstandard.compress(body, LEVEL)
        start, length = self._put(
            records.Chunk(**about, data=data, uncompressed_crc=zlib.crc32(body))
        )
        index = records.ChunkIndex(
            **about,
            chunk_start_offset=start,
            chunk_length=length,
            message_index_offsets={},
            message_index_length=0,
            compressed_size=len(data),
        )
        for channel, times in self._times.items():
            index.message_index_offsets[channel] = self.bytes
            entries = struct.pack(f"<{len(times)}Q", *times)
            head = MESSAGE_INDEX.pack(Opcode.MESSAGE_INDEX, 6 + len(entries), channel, len(entries))
            index.message_index_length += self._write(head + entries)
            self._counts[channel] += len(times) // 2
        self._chunks.append(index)
        self._body, self.waiting_B = [], 0
        self._times.clear()

    def _statistics(self) -> records.Statistics:
        return records.Statistics(
            attachment_count=len(self._attached),
            channel_count=len(self._channels),
            channel_message_counts=dict(self._counts),
            chunk_count=len(self._chunks),
            message_count=sum(self._counts.values()),
            message_start_time=min((c.message_start_time for c in self._chunks), default=0),
            message_end_time=max((c.message_end_time for c in self._chunks), default=0),
            metadata_count=len(self._metadata),
            schema_count=len(self._schemas),
        )

    def _put(self, record: records.McapRecord) -> tuple[int, int]:
        """Write a record; return its offset and length."""
        builder = RecordBuilder()
        record.write(builder)
        start = self.bytes
        return start, self._write(builder.end())

    def _write(self, data: bytes) -> int:
        self._stream.write(data)
        self.bytes += len(data)
        return len(data)
