"""multipart/form-data as it streams in: known fields, each as often as it may come and within its size.

Starlette's own form parser would spool files to disk, accept any field name and any end of the body;
this one writes the parts to the memory that the workers read (the body limit bounds them) and refuses at the
first wrong byte.
"""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING

from python_multipart.exceptions import FormParserError
from python_multipart.multipart import MultipartParser, parse_options_header
from starlette.requests import Request

from boxlift_service.bodies.shared_parts import HeldBytes, SharedParts
from boxlift_service.problems import Kind, ProblemError

if TYPE_CHECKING:
    from python_multipart.multipart import MultipartCallbacks


@dataclass(frozen=True)
class Field:
    """A field that a form may have, how large each of its parts may be and how many there may be."""

    max_bytes: int
    required: bool = False
    max_parts: int = 1


async def read_form(
    request: Request, fields: Mapping[str, Field], held: HeldBytes | None = None
) -> SharedParts:
    """The parts of a request's form; whoever asked for them closes them.

    Raises ProblemError: not multipart (415), malformed (400), a part beyond its size (413), a field that is
    unknown, missing or comes too often (422), no room among the `held` bytes (429).
    """
    parts = SharedParts(held)
    try:
        reader = _FormReader(_boundary(request), fields, parts)
        async for chunk in request.stream():
            reader.write(chunk)
        reader.finish()
    except FormParserError as error:
        parts.close()
        raise _unreadable(f"The form is malformed ({error!s:.120}).") from None
    except BaseException:
        parts.close()
        raise
    return parts


def _boundary(request: Request) -> bytes:
    content_type = request.headers.get("content-type", "")
    media_type, parameters = parse_options_header(content_type)
    if media_type != b"multipart/form-data":
        raise ProblemError(
            Kind.UNSUPPORTED_MEDIA_TYPE,
            f"The Content-Type is {content_type!r:.80}." if content_type else "There is no Content-Type.",
            "Send multipart/form-data.",
            headers={"Accept-Post": "multipart/form-data, application/msgpack"},
        )
    if not parameters.get(b"boundary"):
        raise _unreadable("The Content-Type names no boundary.")
    return parameters[b"boundary"]


def _unreadable(problem: str) -> ProblemError:
    return ProblemError(Kind.UNREADABLE_BODY, problem, "Let an HTTP library build the form.")


def require_fields(parts: SharedParts, fields: Mapping[str, Field]) -> None:
    """Raises ProblemError (422) where a required field is missing."""
    for name, field in fields.items():
        if field.required and name not in parts:
            raise _invalid(name, f"The form has no field {name!r}.", "Add it.")


def printable(name: str) -> str | None:
    """A name that a client sent, as errors may show it: whoever reads them may print it."""
    return name[:60] if name.isprintable() else None


def _invalid(name: str | None, problem: str, remedy: str) -> ProblemError:
    return ProblemError(Kind.INVALID_FIELD, problem, remedy, field=name)


class _FormReader:
    """Callbacks of the push parser, which reports headers and data piece by piece."""

    def __init__(self, boundary: bytes, fields: Mapping[str, Field], parts: SharedParts) -> None:
        callbacks: MultipartCallbacks = {
            "on_part_begin": self._on_part_begin,
            "on_header_field": self._on_header_field,
            "on_header_value": self._on_header_value,
            "on_header_end": self._on_header_end,
            "on_headers_finished": self._on_headers_finished,
            "on_part_data": self._on_part_data,
            "on_part_end": self._on_part_end,
            "on_end": self._on_end,
        }
        try:
            self._parser = MultipartParser(boundary, callbacks)
        except FormParserError as error:
            raise _unreadable(f"The boundary is refused ({error!s:.120}).") from None
        self._opening = self._delimiter = b"--" + boundary
        self._fields = fields
        self._parts = parts
        self._complete = False
        self._on_part_begin()

    def write(self, chunk: bytes) -> None:
        # What comes before the first boundary the parser accepts or refuses by how the body is cut.
        if self._opening == self._delimiter:
            chunk = chunk.lstrip(b"\r\n")
        expected, self._opening = self._opening[: len(chunk)], self._opening[len(chunk) :]
        if not chunk.startswith(expected):
            raise _unreadable("The form does not begin with its boundary.")
        self._parser.write(chunk)

    def finish(self) -> None:
        if not self._complete:
            raise _unreadable("The form ends before its last boundary.")
        require_fields(self._parts, self._fields)

    def _on_part_begin(self) -> None:
        self._header_name = b""
        self._header_value = b""
        self._disposition = b""
        self._name = ""
        self._filename: str | None = None

    def _on_header_field(self, data: bytes, start: int, end: int) -> None:
        self._header_name += data[start:end]

    def _on_header_value(self, data: bytes, start: int, end: int) -> None:
        self._header_value += data[start:end]

    def _on_header_end(self) -> None:
        if self._header_name.lower() == b"content-disposition":
            self._disposition = self._header_value
        self._header_name = b""
        self._header_value = b""

    def _on_headers_finished(self) -> None:
        _, parameters = parse_options_header(self._disposition)
        if b"name" not in parameters:
            raise _unreadable("A part of the form has no name in its Content-Disposition.")
        self._name = parameters[b"name"].decode("utf-8", "replace")
        if self._name not in self._fields:
            known = ", ".join(self._fields)
            raise _invalid(
                printable(self._name), f"The field {self._name!r:.60} is unknown.", f"Known fields: {known}."
            )
        most = self._fields[self._name].max_parts
        if self._parts.count(self._name) >= most:
            often, remedy = ("twice", "once") if most == 1 else (f"{most + 1} times", f"at most {most} times")
            raise _invalid(self._name, f"The field {self._name!r} comes {often}.", f"Send it {remedy}.")
        if b"filename" in parameters:
            self._filename = parameters[b"filename"].decode("utf-8", "replace")

    def _on_part_data(self, data: bytes, start: int, end: int) -> None:
        limit = self._fields[self._name].max_bytes
        if self._parts.part_size + end - start > limit:
            raise ProblemError(
                Kind.TOO_LARGE,
                f"The field {self._name!r} has more than {limit} bytes.",
                f"Send at most {limit} bytes.",
                field=self._name,
            )
        self._parts.write(memoryview(data)[start:end])

    def _on_part_end(self) -> None:
        self._parts.end_part(self._name, self._filename)

    def _on_end(self) -> None:
        self._complete = True
