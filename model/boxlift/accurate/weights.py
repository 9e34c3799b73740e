"""Numbers of the evidence, and where they come from."""

# Rounded from what benchmarks/evidence_weights.py fits to generated scenes, with two exceptions. Generated
# prompts are exact, and so `behind` (rays that miss the box within the prompt) is worth less here than there.
# Generated cars keep their distance, and so `contained` is worth nothing there; it is ours. No labelled
# real frame had a part in the fit; the rounded table was checked on real drives.
EVIDENCE_WEIGHTS = {
    "sides": 0.12,
    "vertical": 0.12,
    "length": 1.0,
    "width": 2.0,
    "height": 1.0,
    "on": -7.0,
    "through": 20.0,
    "behind": 10.0,
    "span": -1.5,
    "contained": -5.0,
    "spill": 10.0,
    "count": -0.5,
    "misfit": 4.0,
}

# From benchmarks/calibration.py: drive 0009 of KITTI and generated scenes; in the order of
# probability.FEATURES.
PROBABILITY_WEIGHTS = {
    0.5: (0.76, -1.33, -1.21, -0.32, -2.63, -9.03, 0.35, 0.23, 0.84, 0.17, -1.68),
    0.7: (-2.23, -0.83, -1.64, 0.48, -2.67, -5.47, 0.26, -0.11, 0.91, 0.67, -2.27),
}
