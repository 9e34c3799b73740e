"""Which media type to answer with (RFC 9110, section 12.5.1)."""

from __future__ import annotations

from collections.abc import Sequence

from boxlift_service.problems import Kind, ProblemError


def negotiate(accept: str | None, offered: Sequence[str]) -> str:
    """The media type of `offered` that the header Accept likes best; the first one where it likes all alike.

    Raises ProblemError (406) where it accepts none.
    """
    if accept is None or not accept.strip():
        return offered[0]
    qualities = [_quality(accept, media_type) for media_type in offered]
    best = max(qualities)
    if best == 0:
        raise ProblemError(
            Kind.NOT_ACCEPTABLE,
            f"The client accepts {accept!r:.120}.",
            f"Accept one of {', '.join(offered)}.",
        )
    return offered[qualities.index(best)]


def _quality(accept: str, media_type: str) -> float:
    """How much `accept` likes a type: the q of its most specific range that matches, 0 for none."""
    specificity = {media_type: 2, f"{media_type.partition('/')[0]}/*": 1, "*/*": 0}
    best_rank, quality = -1, 0.0
    for item in accept.lower().split(","):
        media_range, *parameters = (part.strip() for part in item.split(";"))
        rank = specificity.get(media_range, -1)
        if rank > best_rank:
            best_rank, quality = rank, _q(parameters)
    return quality


def _q(parameters: Sequence[str]) -> float:
    for parameter in parameters:
        name, _, value = parameter.partition("=")
        if name.strip() == "q":
            try:
                q = float(value)
            except ValueError:
                return 0.0
            return q if 0 <= q <= 1 else 0.0
    return 1.0
