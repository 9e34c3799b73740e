"""Archives and packed files, told by their first bytes: nothing here unpacks what a stranger sends."""

from __future__ import annotations

# As a LiDAR return, the gzip's to lz4's first four bytes would be under a millimetre or beyond 100 km.
_MAGICS = (
    (0, b"PK\x03\x04", "a .zip archive"),
    (0, b"PK\x05\x06", "an empty .zip archive"),
    (0, b"PK\x07\x08", "a .zip archive"),
    (257, b"ustar", "a .tar archive"),
    (0, b"\xfd7zXZ\x00", "packed by xz"),
    (0, b"7z\xbc\xaf\x27\x1c", "a .7z archive"),
    (0, b"Rar!\x1a\x07", "a .rar archive"),
    (0, b"\x28\xb5\x2f\xfd", "packed by zstd"),
    (0, b"\x04\x22\x4d\x18", "packed by lz4"),
)
REMEDY = "Unpack it, and give the file that is in it."


def archive_kind(data: bytes) -> str | None:
    """What archive the data is, in words; None where it is none."""
    if data.startswith(b"\x1f\x8b\x08") and data[3:4] < b"\x20":
        return "packed by gzip"
    if data.startswith(b"BZh") and b"1" <= data[3:4] <= b"9":
        return "packed by bzip2"
    for offset, magic, kind in _MAGICS:
        if data.startswith(magic, offset):
            return kind
    return None
