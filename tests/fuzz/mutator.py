"""Damages files as fuzzers do, from one seed of chance: the same seed, the same damage."""

from __future__ import annotations

import re
import struct
from collections.abc import Callable, Sequence
from random import Random

LONGEST = 65_536
# Numbers at which sizes, counts and coordinates change their meaning.
_INTEGERS = (0, 1, 2, 3, 16, 127, 128, 255, 256, 32_767, 65_535, 65_536, 2**31 - 1, 2**31, 2**32 - 1, 2**63)
_NUMBERS = (
    *(b"0", b"-1", b"1", b"2", b"3", b"1e5", b"-1e30", b"1e308", b"1e400", b"1e-320", b"0.5", b"1.5"),
    *(b"nan", b"inf", b"-inf", b"NaN", b"Infinity", b"true", b"null", b"0x10", b"1_0", b"\xd9\xa3", b"+4"),
    *(
        b"65535",
        b"65536",
        b"4294967296",
        b"9223372036854775807",
        b"99999999999999999999",
        b"9" * 4000,
        b"9" * 5000,
    ),
)
_NUMBER = re.compile(rb"[-+]?\d[\d.eE+-]*")

Damage = Callable[[bytes, Random], bytes]


def damaged(data: bytes, random: Random, words: Sequence[bytes], others: Sequence[bytes]) -> bytes:
    """`data` with one to four damages; `words` are those of its format, `others` files to splice with."""
    for _ in range(random.choice((1, 1, 2, 4))):
        data = _damaged_once(data, random, words, others)
    return data[:LONGEST]


def _damaged_once(data: bytes, random: Random, words: Sequence[bytes], others: Sequence[bytes]) -> bytes:
    kind = random.randrange(12)
    if kind == 0 and others:
        other = random.choice(others)
        return data[: _place(data, random)] + other[_place(other, random) :]
    if kind == 1 and words:
        at = _place(data, random)
        return data[:at] + random.choice(words) + data[at + random.choice((0, 0, 1, 4)) :]
    return random.choice(_DAMAGES)(data, random)


def _place(data: bytes, random: Random) -> int:
    """Somewhere in the data; every other time near its start, where headers are."""
    return random.randrange(1 + (min(len(data), 128) if random.random() < 0.5 else len(data)))


def _flip_bit(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + bytes(byte ^ 1 << random.randrange(8) for byte in data[at : at + 1]) + data[at + 1 :]


def _random_bytes(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + random.randbytes(random.randint(1, 8)) + data[at + random.randrange(9) :]


def _write_integer(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    number, size = random.choice(_INTEGERS), random.choice("BHIQ")
    written = struct.pack(random.choice("<>") + size, number % 2 ** (8 * struct.calcsize(f"<{size}")))
    return data[:at] + written + data[at + len(written) :]


def _delete(data: bytes, random: Random) -> bytes:
    at = _place(data, random)
    return data[:at] + data[at + random.choice((1, 2, 4, 16, 100)) :]


def _repeat(data: bytes, random: Random) -> bytes:
    at, size = _place(data, random), random.choice((1, 4, 13, 100))
    times = random.choice((1, 2, 10, 200))
    return data[:at] + data[at : at + size] * times + data[at:]


def _move(data: bytes, random: Random) -> bytes:
    start, size = _place(data, random), random.choice((1, 4, 16, 100))
    rest = data[:start] + data[start + size :]
    to = _place(rest, random)
    return rest[:to] + data[start : start + size] + rest[to:]


def _cut(data: bytes, random: Random) -> bytes:
    return data[: _place(data, random)]


def _change_number(data: bytes, random: Random) -> bytes:
    """Another number in the place of one that is written as text."""
    numbers = list(_NUMBER.finditer(data[:LONGEST]))
    if not numbers:
        return _flip_bit(data, random)
    start, end = random.choice(numbers).span()
    return data[:start] + random.choice(_NUMBERS) + data[end:]


def _change_line(data: bytes, random: Random) -> bytes:
    """A line twice, not at all, or elsewhere."""
    lines = data.split(b"\n")
    line = lines.pop(random.randrange(len(lines)))
    for _ in range(random.choice((0, 1, 2, 30))):
        lines.insert(random.randrange(len(lines) + 1), line)
    return b"\n".join(lines)


def _nest(data: bytes, random: Random) -> bytes:
    """Brackets, as deep as no parser goes."""
    at, depth = _place(data, random), random.choice((1, 3, 100, 2000))
    opening, closing = random.choice(((b"[", b"]"), (b'{"a":', b"}"), (b"(", b")")))
    return data[:at] + opening * depth + data[at:] + closing * random.choice((0, depth))


_DAMAGES: tuple[Damage, ...] = (
    _flip_bit, _random_bytes, _write_integer, _write_integer, _delete, _repeat, _move, _cut,
    _change_number, _change_number, _change_line, _nest,
)  # fmt: skip
