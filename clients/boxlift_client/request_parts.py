"""What requests are made of: the fields of a form, and how they travel."""

from __future__ import annotations

from pathlib import Path

from boxlift.errors import InputError, MissingExtraError

# File name, content, media type.
Part = tuple[str | None, bytes, str]
# Field of a form -> its part.
Form = dict[str, Part]
# (Field, part), where a field may come several times.
Parts = list[tuple[str, Part]]

# A file by its path, or what is in it.
File = Path | str | bytes

JSON = "application/json"
BINARY = "application/octet-stream"
TEXT = "text/plain; charset=utf-8"
PNG = "image/png"
MSGPACK = "application/msgpack"


def content(field: str, source: File) -> bytes:
    """The bytes of a file. Raises InputError where it cannot be read."""
    if isinstance(source, bytes):
        return source
    try:
        return Path(source).read_bytes()
    except OSError as error:
        raise InputError(field, f"{str(source)!r} cannot be read ({error.strerror}).", "Check it.") from None


def packed(form: Form) -> bytes:
    """A form as a msgpack map: each field its bytes, and the file name of the points beside them."""
    try:
        import msgpack
    except ModuleNotFoundError:
        raise MissingExtraError("msgpack", "client") from None
    fields: dict[str, bytes | str] = {name: data for name, (_, data, _) in form.items()}
    if (filename := form["points"][0]) is not None:
        fields["points_filename"] = filename
    data: bytes = msgpack.packb(fields)
    return data
