"""API keys: a file of their hashes, read again when it changes.

A line is `NAME SHA256 [REQUESTS_PER_MINUTE]`, the hash in hexadecimal digits; `#` begins a comment. A key is
256 random bits: nobody can try them all, so that a plain SHA-256 hides it as well as a slow hash would.
"""

from __future__ import annotations

import fcntl
import hmac
import logging
import os
import re
import secrets
import stat
import tempfile
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from hashlib import sha256
from pathlib import Path
from time import monotonic

from boxlift.errors import OptionsError

PREFIX = "boxlift_"
MAX_FILE_BYTES = 2**18  # about 2,500 keys; all are compared for every request

_NAMES = "Take up to 64 of A-Z a-z 0-9 . _ -"
_LINE = "Write NAME SHA256 [REQUESTS_PER_MINUTE], as `boxlift keys new` does."
_NAME = re.compile(r"[A-Za-z0-9._-]{1,64}")
_HASH = re.compile(r"[0-9a-fA-F]{64}")
_RATE = re.compile(r"[0-9]{1,6}")

_log = logging.getLogger("boxlift_service")

# Device, inode, length and the times of the content and of the inode.
_Version = tuple[int, int, int, int, int]


@dataclass(frozen=True)
class ApiKey:
    """What is kept of a key. `requests_per_minute` None: what the settings say; 0: no limit."""

    name: str
    digest: bytes
    requests_per_minute: int | None = None

    @property
    def line(self) -> str:
        """The key's line in the file."""
        rate = "" if self.requests_per_minute is None else f" {self.requests_per_minute}"
        return f"{self.name} {self.digest.hex()}{rate}"


def new_key(name: str, requests_per_minute: int | None = None) -> tuple[str, ApiKey]:
    """A new key as its holder sends it (boxlift_ and 256 random bits), and what is kept of it.

    Raises OptionsError for an unusable name.
    """
    if not _NAME.fullmatch(name):
        raise OptionsError("NAME", f"{name!r:.80} cannot be a key's name.", _NAMES)
    secret = PREFIX + secrets.token_urlsafe(32)
    return secret, ApiKey(name, digest_of(secret.encode()), requests_per_minute)


def digest_of(secret: bytes) -> bytes:
    """What the file holds of a key, 32 bytes."""
    return sha256(secret).digest()


def parse_keys(text: str, source: str) -> tuple[ApiKey, ...]:
    """Keys of a file's text. Raises OptionsError that names `source` and the line, never what is on it."""
    keys: list[ApiKey] = []
    names: set[str] = set()
    digests: set[bytes] = set()
    for number, line in enumerate(text.splitlines(), start=1):
        if words := line.partition("#")[0].split():
            place = f"{source}:{number}"
            key = _key(words, place)
            if key.name in names:
                raise OptionsError(
                    place, f"the name {key.name!r} is taken above.", "Give every key its own name."
                )
            if key.digest in digests:
                raise OptionsError(place, "the same key is above.", "Remove one of the two lines.")
            keys.append(key)
            names.add(key.name)
            digests.add(key.digest)
    return tuple(keys)


def _key(words: list[str], place: str) -> ApiKey:
    if len(words) not in (2, 3):
        raise OptionsError(place, f"{len(words)} words instead of 2 or 3.", _LINE)
    name, digest, *rate = words
    if not _NAME.fullmatch(name):
        raise OptionsError(place, "the name is unusable.", _NAMES)
    if digest.startswith(PREFIX):
        raise OptionsError(place, "the key itself is here, not its hash.", f"Revoke it. {_LINE}")
    if not _HASH.fullmatch(digest):
        raise OptionsError(place, "the hash has not 64 hexadecimal digits.", _LINE)
    if rate and not _RATE.fullmatch(rate[0]):
        raise OptionsError(place, "requests per minute are no number from 0 to 999999.", _LINE)
    return ApiKey(name, bytes.fromhex(digest), int(rate[0]) if rate else None)


def read_keys(path: Path) -> tuple[ApiKey, ...]:
    """Keys of a file. Raises OptionsError where it cannot be read or used."""
    return _read(path)[0]


def add_key(path: Path, key: ApiKey) -> None:
    """Append the key's line; a new file is for its owner alone.

    Raises OptionsError where the file is broken or knows the name, OSError where it cannot be written.
    """
    with _edited(path) as lines:
        lines.append(key.line)


def revoke_key(path: Path, name: str) -> None:
    """Remove the key's line. Raises OptionsError where the file is broken or has no such key, OSError."""
    with _edited(path) as lines:
        left = [line for line in lines if line.partition("#")[0].split()[:1] != [name]]
        if len(left) == len(lines):
            raise OptionsError(str(path), f"the file has no key {name!r:.80}.", "See `boxlift keys list`.")
        lines[:] = left


@contextmanager
def _edited(path: Path) -> Iterator[list[str]]:
    """Lines of the file, to be changed: what they are in the end takes its place in one step."""
    target = path.resolve()
    folder = os.open(target.parent, os.O_RDONLY | os.O_DIRECTORY)
    try:
        # Two who add a key at the same time would lose one of them.
        fcntl.flock(folder, fcntl.LOCK_EX)
        lines = []
        if target.exists():
            read_keys(target)
            lines = target.read_text(encoding="utf-8-sig").splitlines()
        yield lines
        text = "".join(f"{line}\n" for line in lines)
        parse_keys(text, str(path))
        _replace(target, text)
    finally:
        os.close(folder)


def _replace(path: Path, text: str) -> None:
    descriptor, name = tempfile.mkstemp(dir=path.parent, prefix=f".{path.name}.")
    try:
        with os.fdopen(descriptor, "w", encoding="utf-8") as stream:
            if path.exists():
                # The service may read it as its owner or by its group.
                old = path.stat()
                os.fchown(descriptor, old.st_uid, old.st_gid)
                os.fchmod(descriptor, stat.S_IMODE(old.st_mode))
            stream.write(text)
            stream.flush()
            os.fsync(descriptor)
        Path(name).replace(path)
    except BaseException:
        Path(name).unlink()
        raise


class ApiKeys:
    """The keys of a file as it is now.

    The file is looked at when somebody asks, every `check_every_s` seconds at most. One that is broken or
    gone is logged once and leaves the keys as they are; one without a key refuses everybody.
    """

    def __init__(self, path: Path, check_every_s: float = 1.0) -> None:
        """Raises OptionsError where the file cannot be used or has no key."""
        self._path = path
        self._check_every_s = check_every_s
        self._keys, self._version = _read(path)
        if not self._keys:
            raise OptionsError(str(path), "the file has no key.", "Make one with `boxlift keys new`.")
        self._next_check = monotonic() + check_every_s

    def find(self, secret: bytes) -> ApiKey | None:
        """The key that `secret` is, or None."""
        self._read_if_changed()
        digest = digest_of(secret)
        found = None
        for key in self._keys:
            # To the end in any case: how long it takes says nothing about the keys.
            if hmac.compare_digest(key.digest, digest):
                found = key
        return found

    def _read_if_changed(self) -> None:
        now = monotonic()
        if now < self._next_check:
            return
        self._next_check = now + self._check_every_s
        try:
            version = _version(self._path.stat())
        except OSError:
            version = None
        if version == self._version:
            return
        self._version = version
        try:
            self._keys, self._version = _read(self._path)
        except OptionsError as error:
            _log.error("the API keys stay as they were: %s", error)
        else:
            _log.info("API keys read again: %s", ", ".join(key.name for key in self._keys) or "none is left")


def _read(path: Path) -> tuple[tuple[ApiKey, ...], _Version | None]:
    try:
        with path.open("rb") as stream:
            version = _version(os.fstat(stream.fileno()))
            content = stream.read(MAX_FILE_BYTES + 1)
        text = content.decode("utf-8-sig")
    except OSError as error:
        raise OptionsError(
            str(path),
            f"the file cannot be read: {error.strerror or error}.",
            "Make one with `boxlift keys new`.",
        ) from None
    except UnicodeDecodeError:
        raise OptionsError(str(path), "the file is no UTF-8 text.", _LINE) from None
    if len(content) > MAX_FILE_BYTES:
        raise OptionsError(
            str(path), f"the file has more than {MAX_FILE_BYTES} bytes.", "Remove keys that nobody uses."
        )
    return parse_keys(text, str(path)), version


def _version(status: os.stat_result) -> _Version:
    return (status.st_dev, status.st_ino, status.st_size, status.st_mtime_ns, status.st_ctime_ns)
