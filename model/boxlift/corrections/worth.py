"""Which objects are worth a look first."""

from __future__ import annotations

import math

from boxlift.formats.details import ObjectDetails

# Flags that most boxes have say nothing about one of them.
_COMMON_FLAGS = frozenset({"heading_ambiguous", "size_from_prior"})
_PER_FLAG = 0.05
# What a prompt without a box is worth at most: somebody has to draw that box, one keystroke does not do.
_WITHOUT_BOX = 0.5


def worth_a_look(item: ObjectDetails) -> float:
    """0 to about 1.3: what a look at an object tells at most.

    For a box the binary entropy (bits) of its score, the probability that it is right: one that is nearly
    surely right, or surely wrong, needs no person to say so. Each uncommon flag adds a little. A prompt
    without a box counts by its own score.
    """
    if item.box is None:
        return _WITHOUT_BOX * min(max(item.prompt_score, 0.0), 1.0)
    right = min(max(item.score, 1e-6), 1 - 1e-6)
    entropy = -right * math.log2(right) - (1 - right) * math.log2(1 - right)
    return entropy + _PER_FLAG * len(set(item.flags) - _COMMON_FLAGS)
