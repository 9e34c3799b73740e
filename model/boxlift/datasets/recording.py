"""One MCAP file, read where its index says: which topics, when, and single messages of Foxglove's schemas.

Nothing here goes through a whole recording: times come from the index of each chunk, and of the data only the
chunks are decompressed that hold what is asked for. Source: the specification of MCAP; Foxglove's schemas.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from functools import cached_property
from typing import TYPE_CHECKING, Any

from boxlift.errors import DatasetError, MissingExtraError

if TYPE_CHECKING:
    from boxlift.storage import AnyPath


class Recording:
    """Messages of an MCAP file. Every call opens it anew, so that threads do not meet.

    Raises DatasetError where it is no MCAP file with an index, MissingExtraError without the mcap library.
    """

    def __init__(self, path: AnyPath) -> None:
        self.path = path

    @cached_property
    def times(self) -> dict[str, dict[str, list[int]]]:
        """Log times, sorted, by schema ("foxglove.PointCloud") and topic. Only protobuf messages count."""
        from mcap.records import MessageIndex
        from mcap.stream_reader import StreamReader

        with self._reader() as (reader, file):
            summary = reader.get_summary()
            if summary is None or not summary.chunk_indexes:
                raise DatasetError(
                    str(self.path), "the recording has no index.", "Write one: mcap recover FILE -o NEWFILE."
                )
            found: dict[int, list[int]] = {}
            for chunk in summary.chunk_indexes:
                for channel, offset in chunk.message_index_offsets.items():
                    file.seek(offset)
                    record = next(StreamReader(file, skip_magic=True).records)
                    if isinstance(record, MessageIndex):
                        found.setdefault(channel, []).extend(time for time, _ in record.records)
            by_schema: dict[str, dict[str, list[int]]] = {}
            for number, channel in summary.channels.items():
                if channel.message_encoding == "protobuf" and number in found:
                    topics = by_schema.setdefault(summary.schemas[channel.schema_id].name, {})
                    topics[channel.topic] = sorted(topics.get(channel.topic, []) + found[number])
            return by_schema

    @cached_property
    def other_encodings(self) -> list[str]:
        """What else the recording has, e.g. "sensor_msgs/msg/PointCloud2 (cdr)"."""
        with self._reader() as (reader, _):
            summary = reader.get_summary()
            channels = [] if summary is None else summary.channels.values()
            return sorted(
                f"{summary.schemas[each.schema_id].name} ({each.message_encoding})"
                for each in channels
                if each.message_encoding != "protobuf" and each.schema_id in summary.schemas
            )

    def messages(self, topics: list[str], start_ns: int, end_ns: int) -> Iterator[tuple[str, int, Any]]:
        """(topic, log time, message) from start to end, both included, in the order of time."""
        with self._reader() as (reader, _):
            found = reader.iter_decoded_messages(topics, starting_at=start_ns, ending_at=end_ns)
            for _, channel, message, decoded in found:
                yield channel.topic, message.log_time, decoded

    def message(self, topic: str, time_ns: int) -> Any:
        """The message of a topic that was logged at a time. Raises DatasetError."""
        for _, _, decoded in self.messages([topic], time_ns, time_ns):
            return decoded
        raise DatasetError(str(self.path), f"{topic} has no message at {time_ns}.", "Check the time.")

    @contextmanager
    def _reader(self) -> Iterator[tuple[Any, Any]]:
        try:
            from mcap.exceptions import McapError
            from mcap.reader import SeekingReader
            from mcap_protobuf.decoder import DecoderFactory
        except ImportError:
            raise MissingExtraError("mcap-protobuf-support", "datasets") from None
        try:
            with self.path.open("rb") as file:
                yield SeekingReader(file, decoder_factories=[DecoderFactory()]), file
        except McapError as error:
            raise DatasetError(
                str(self.path), f"the file is no MCAP recording ({error!s:.120}).", "Check it: mcap doctor."
            ) from None


def timestamp_ns(message: Any, log_time_ns: int) -> int:
    """When what a message tells was measured; when it was logged, where it does not say."""
    stamp = int(message.timestamp.seconds) * 1_000_000_000 + int(message.timestamp.nanos)
    return stamp or log_time_ns
