"""msgpack maps as they stream in: known fields, each once and within its size, into shared memory.

Of msgpack only what a frame needs is read: a map whose keys are strings and whose values are bin or str,
the bytes that the field of a form would have. Nothing nests and nothing is an extension, so a header costs
no memory before its bytes have come, and a value that is too large is passed over without being kept: the
next map of the stream can be read. (The library msgpack offers no way to do so.)
"""

from __future__ import annotations

import asyncio
from collections.abc import AsyncIterator, Mapping
from time import monotonic

from boxlift_service.bodies.form import Field, printable
from boxlift_service.bodies.shared_parts import HeldBytes, SharedParts
from boxlift_service.problems import Kind, ProblemError

MEDIA_TYPE = "application/msgpack"
_MEDIA_TYPES = (MEDIA_TYPE, "application/vnd.msgpack", "application/x-msgpack")

# Beside the fields of a form: what a form says in the header of a part.
_FILENAME_OF = {"points_filename": "points"}
_LONGEST_FILENAME = 1000
_LONGEST_KEY = 100
_MOST_ENTRIES = 100

_FIXMAP, _FIXSTR = range(0x80, 0x90), range(0xA0, 0xC0)
# First byte -> how many bytes say the length.
_MAP_LENGTHS = {0xDE: 2, 0xDF: 4}
_STR_LENGTHS = {0xD9: 1, 0xDA: 2, 0xDB: 4}
_BIN_LENGTHS = {0xC4: 1, 0xC5: 2, 0xC6: 4}

_LOOKS_FOR_ROOM_EVERY_S = 0.02


def is_msgpack(content_type: str) -> bool:
    """Whether a Content-Type is one of msgpack's."""
    return content_type.partition(";")[0].strip().lower() in _MEDIA_TYPES


async def read_msgpack(
    chunks: AsyncIterator[bytes],
    fields: Mapping[str, Field],
    held: HeldBytes | None = None,
) -> SharedParts:
    """The parts of a body that is one map. Close them.

    Raises ProblemError: malformed (400), a field beyond its size (413), one that is unknown, missing or comes
    twice (422), no room (429).
    """
    reader = MapReader(chunks, fields, held)
    parts = SharedParts(held)
    try:
        if (problem := await reader.read_map(parts)) is not None:
            raise problem
        if not await reader.at_end():
            raise _unreadable("Bytes follow the map.")
    except BaseException:
        parts.close()
        raise
    return parts


class MapReader:
    """Reads the maps of a stream one after the other; what is wrong with the fields of one costs no other."""

    def __init__(
        self,
        chunks: AsyncIterator[bytes],
        fields: Mapping[str, Field],
        held: HeldBytes | None = None,
        *,
        max_bytes: int | None = None,
        waits_for_room_s: float = 0.0,
    ) -> None:
        """max_bytes: of all values of a map. waits_for_room_s: how long for room in `held`, per map."""
        self._bytes = _Bytes(chunks)
        self._fields = fields
        self._held = held
        self._max_bytes = max_bytes
        self._waits_for_room_s = waits_for_room_s

    async def at_end(self) -> bool:
        """Whether the stream has ended, where a map could begin."""
        return await self._bytes.at_end()

    async def read_map(self, parts: SharedParts) -> ProblemError | None:
        """Read one map into `parts`, and return the first thing that is wrong with its fields.

        The fields at fault are missing in `parts` then, and the stream can be read on. Raises ProblemError
        (400) where it cannot: no map, not msgpack, cut.
        """
        entries = _Entries(self._fields, self._max_bytes)
        room_until = monotonic() + self._waits_for_room_s
        for _ in range(await self._map_size()):
            name = await self._key()
            size = await self._value_size(name)
            refused = entries.refuses(name, size)
            if name in _FILENAME_OF and not refused:
                entries.filenames[_FILENAME_OF[name]] = (await self._bytes.exactly(size)).decode(
                    errors="replace"
                )
                continue
            left = size
            while left:
                piece = await self._bytes.piece(left)
                left -= len(piece)
                refused = refused or not await self._write(piece, parts, entries, room_until)
            if not refused:
                parts.end_part(name)
        for name, filename in entries.filenames.items():
            if name in parts:
                parts.name_file(name, filename)
        return entries.problem_at_end()

    async def _write(
        self, piece: memoryview, parts: SharedParts, entries: _Entries, room_until: float
    ) -> bool:
        """Whether there is room, now or soon."""
        while self._held is not None and not self._held.has_room(len(piece)) and monotonic() < room_until:
            await asyncio.sleep(_LOOKS_FOR_ROOM_EVERY_S)
        try:
            parts.write(piece)
        except ProblemError as error:
            entries.no_room(error)
            return False
        return True

    async def _map_size(self) -> int:
        first = await self._bytes.number(1)
        if first in _FIXMAP:
            return first - _FIXMAP.start
        if first not in _MAP_LENGTHS:
            raise _unreadable(f"The byte 0x{first:02x} begins no map.")
        size = await self._bytes.number(_MAP_LENGTHS[first])
        if size > _MOST_ENTRIES:
            raise _unreadable(f"A map has {size} entries; no frame has so many.")
        return size

    async def _key(self) -> str:
        first = await self._bytes.number(1)
        if first not in _FIXSTR and first not in _STR_LENGTHS:
            raise _unreadable(f"The byte 0x{first:02x} begins no string, as a key must be.")
        size = await self._length(first)
        if size > _LONGEST_KEY:
            raise _unreadable(f"A key has {size} bytes.")
        return (await self._bytes.exactly(size)).decode("utf-8", "replace")

    async def _value_size(self, name: str) -> int:
        first = await self._bytes.number(1)
        if first in _FIXSTR or first in _STR_LENGTHS or first in _BIN_LENGTHS:
            return await self._length(first)
        raise _unreadable(
            f"The value of {name!r:.60} (0x{first:02x}) is neither bin nor str.",
            "Pack files as bin, and prompts, options and name as bin or str (JSON text where a form has it).",
        )

    async def _length(self, first: int) -> int:
        """Of the str or bin that begins with the byte `first`."""
        if first in _FIXSTR:
            return first - _FIXSTR.start
        return await self._bytes.number((_STR_LENGTHS | _BIN_LENGTHS)[first])


class _Entries:
    """What has come of a map, and the first thing that is wrong with it."""

    def __init__(self, fields: Mapping[str, Field], max_bytes: int | None) -> None:
        self.filenames: dict[str, str] = {}
        self._fields = fields
        self._max_bytes = max_bytes
        self._seen: set[str] = set()
        self._kept_bytes = 0
        self._full = False
        self._problem: ProblemError | None = None

    def refuses(self, name: str, size: int) -> bool:
        """Whether the value that comes now is to be passed over."""
        problem = self._refusal(name, size)
        self._problem = self._problem or problem
        self._seen.add(name)
        if problem is None:
            self._kept_bytes += size
        return problem is not None or self._full

    def no_room(self, problem: ProblemError) -> None:
        """Pass over all that comes: a part that was begun cannot be taken back."""
        self._problem = self._problem or problem
        self._full = True

    def problem_at_end(self) -> ProblemError | None:
        """The first thing that is wrong, now that all of the map has come."""
        for name, field in self._fields.items():
            if field.required and name not in self._seen:
                return self._problem or _invalid(name, f"The map has no field {name!r}.", "Add it.")
        return self._problem

    def _refusal(self, name: str, size: int) -> ProblemError | None:
        if name not in self._fields and name not in _FILENAME_OF:
            known = ", ".join((*self._fields, *_FILENAME_OF))
            return _invalid(printable(name), f"The field {name!r:.60} is unknown.", f"Known fields: {known}.")
        if name in self._seen:
            return _invalid(name, f"The field {name!r} comes twice.", "Send it once.")
        limit = _LONGEST_FILENAME if name in _FILENAME_OF else self._fields[name].max_bytes
        if size > limit:
            return _too_large(f"The field {name!r} has {size} bytes.", limit, name)
        if self._max_bytes is not None and self._kept_bytes + size > self._max_bytes:
            return _too_large(f"The frame has more than {self._max_bytes} bytes.", self._max_bytes, None)
        return None


class _Bytes:
    """Bytes that come in chunks, taken by their number."""

    def __init__(self, chunks: AsyncIterator[bytes]) -> None:
        self._chunks = chunks
        self._chunk = memoryview(b"")

    async def at_end(self) -> bool:
        while not self._chunk:
            try:
                self._chunk = memoryview(await anext(self._chunks))
            except StopAsyncIteration:
                return True
        return False

    async def piece(self, most: int) -> memoryview:
        """The next bytes, as many as have come and at most so many."""
        if await self.at_end():
            raise _unreadable("The body ends within a map.")
        piece, self._chunk = self._chunk[:most], self._chunk[most:]
        return piece

    async def exactly(self, count: int) -> bytes:
        taken = bytearray()
        while len(taken) < count:
            taken += await self.piece(count - len(taken))
        return bytes(taken)

    async def number(self, size: int) -> int:
        """A big-endian number of so many bytes."""
        return int.from_bytes(await self.exactly(size), "big")


def _unreadable(problem: str, remedy: str = "Let a msgpack library build the body.") -> ProblemError:
    return ProblemError(Kind.UNREADABLE_BODY, problem, remedy)


def _invalid(name: str | None, problem: str, remedy: str) -> ProblemError:
    return ProblemError(Kind.INVALID_FIELD, problem, remedy, field=name)


def _too_large(problem: str, limit: int, name: str | None) -> ProblemError:
    return ProblemError(Kind.TOO_LARGE, problem, f"Send at most {limit} bytes.", field=name)
