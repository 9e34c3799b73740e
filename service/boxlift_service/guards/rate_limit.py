"""How often a key may ask: a bucket of tokens per key, refilled evenly."""

from __future__ import annotations

_MINUTE_S = 60.0
# Sums of floats must not cost the last token of a minute.
_ROUNDING_S = 1e-3


class RateLimits:
    """Requests of each key: a minute's worth at once, and then as they come back, evenly.

    A bucket is told by when it will be full again, which is a minute after its last request at most. Full
    ones are forgotten, so that no more are held than keys were used within a minute.
    """

    def __init__(self) -> None:
        self._full_at: dict[str, float] = {}

    def wait_s(self, name: str, requests_per_minute: int, now: float) -> float:
        """Take a token at the time `now`, seconds: 0, or in how many seconds there will be one.

        `requests_per_minute` 0 is no limit.
        """
        if not requests_per_minute:
            return 0.0
        if name not in self._full_at:
            self._full_at = {key: full_at for key, full_at in self._full_at.items() if full_at > now}
        token_s = _MINUTE_S / requests_per_minute
        full_at = max(self._full_at.get(name, now), now) + token_s
        if full_at - now > _MINUTE_S + min(token_s / 2, _ROUNDING_S):
            return min(full_at - now - _MINUTE_S, token_s)
        self._full_at[name] = full_at
        return 0.0

    def __len__(self) -> int:
        """How many buckets are held."""
        return len(self._full_at)
