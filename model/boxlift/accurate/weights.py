"""Numbers that were fitted to generated scenes, by the command that each table names."""

EVIDENCE_WEIGHTS = {
    "sides": 0.13,
    "vertical": 0.09,
    "length": 0.14,
    "width": 2.85,
    "height": 2.2,
    "on": -8.94,
    "through": 35.67,
    "behind": 7.87,
    "span": -2.08,
    "contained": -6.05,
    "spill": 9.41,
    "count": -0.59,
    "misfit": 4.42,
}
