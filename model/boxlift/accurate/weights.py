"""Numbers of the evidence, and where they come from."""

# Rounded from what benchmarks/evidence_weights.py fits to generated scenes, with two exceptions. Generated
# prompts are exact, and so `behind` (rays that miss the box within the prompt) is worth less here than there.
# Generated cars keep their distance, and so `contained` is worth nothing there; it is ours. No labelled
# real frame had a part in the fit; the rounded table was checked on real drives. `sides` and `vertical` (.1
# there), `ground` and `short` (nothing there) were raised by hand after looking at the worst boxes of the
# development frames: a car that the prompt's edges, the ground and the points before it speak against.
EVIDENCE_WEIGHTS = {
    "sides": 0.3,
    "vertical": 0.3,
    "length": 1.0,
    "width": 2.0,
    "height": 1.0,
    "ground": 0.3,
    "on": -7.0,
    "short": 2.0,
    "through": 20.0,
    "behind": 10.0,
    "span": -1.5,
    "contained": -5.0,
    "spill": 10.0,
    "count": -0.5,
    "misfit": 4.0,
}

# As benchmarks/calibration.py prints them; in the order of probability.FEATURES.
PROBABILITY_WEIGHTS = {
    0.5: (-0.98, -1.40, -1.14, 1.69, -0.25, -3.99, 0.48, 0.30, 0.77, -0.12, -1.45),
    0.7: (-4.09, -1.18, -0.52, 1.31, 3.19, -2.84, 0.50, -0.38, 1.05, 0.47, -2.71),
}
