"""Ablations of Peng et al., "WeakM3D" (ICLR 2022), appendix B: KITTI validation, cars, average precision
(R40) at an IoU of .5 in %: BEV easy, moderate, hard, then 3D easy, moderate, hard.
"""

from __future__ import annotations

# Table 'Detailed ablation study'. D is disentanglement, G geometric alignment, R ray tracing, B balancing.
DETAILED: dict[str, tuple[float, ...]] = {
    "a": (0.11, 0.16, 0.15, 0.08, 0.10, 0.04),
    "b D": (16.16, 11.98, 9.21, 11.55, 8.16, 6.04),
    "c G": (49.09, 24.86, 18.24, 37.79, 17.73, 12.60),
    "d R": (32.39, 14.56, 10.67, 24.79, 10.34, 7.38),
    "e B": (0.77, 0.45, 0.28, 0.26, 0.13, 0.11),
    "f DG": (51.36, 33.08, 26.42, 45.04, 26.34, 21.19),
    "g DR": (49.92, 32.90, 27.32, 41.91, 25.24, 20.50),
    "h DB": (17.79, 12.04, 9.03, 12.75, 7.38, 5.60),
    "i GR": (53.02, 34.53, 26.96, 44.12, 27.07, 21.90),
    "j GB": (51.56, 33.77, 26.73, 44.11, 27.05, 21.10),
    "k RB": (51.44, 32.07, 25.86, 43.79, 26.29, 20.69),
    "l DGR": (55.31, 36.28, 29.03, 48.35, 28.48, 22.18),
    "m DGB": (52.50, 33.45, 26.31, 47.58, 27.93, 21.60),
    "n DRB": (56.25, 34.34, 26.82, 49.78, 27.30, 20.76),
    "o GRB": (56.60, 37.37, 28.68, 49.03, 29.43, 21.77),
    "p DGRB": (58.20, 38.02, 30.17, 50.16, 29.94, 23.11),
}
# Table 'Ablation study for dimension', row 'Learned' (appendix B); its row 'Frozen' is row p.
SIZE_LEARNED = (56.24, 37.04, 29.45, 48.37, 29.41, 22.74)
