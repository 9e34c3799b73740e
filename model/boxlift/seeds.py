"""Seeds from names alone, so that labels depend neither on order, batch, engine nor number of threads."""

from __future__ import annotations

import hashlib


def seed_of(*names: object) -> int:
    """A seed below 2**31 from a frame's name and, where it matters, a prompt's index."""
    digest = hashlib.sha256(":".join(str(name) for name in names).encode()).digest()
    return int.from_bytes(digest[:4]) & 0x7FFFFFFF
