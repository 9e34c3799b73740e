"""How often the fit reaches the global minimum: against brute force, on every object of a dataset.

    python benchmarks/fit_optimality.py [FOLDER] [--prompts label_2] [--preset paper] [--limit N]

FOLDER is a dataset (by default ../shared/kitti/object where it exists, else a dozen generated frames). Every
problem that the labeller hands to the fit is also solved by brute force: the lowest loss on a grid of
0.02 m over +-4 m around the mean of its points. Prints the share of objects whose final loss is at most
1.01 times that minimum, the same for Adam, and time per object. The two are timed in the same run.
"""

from __future__ import annotations

import argparse
import platform
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

import numpy as np
import torch

from boxlift import Frame, InputError
from boxlift.camera import Floats
from boxlift.datasets import load_prompts, open_source
from boxlift.datasets.generated import generate
from boxlift.fit import FitProblem, fit_boxes
from boxlift.labeller import Labeller
from boxlift.losses import BevBoxes, balanced_loss, point_density
from boxlift.settings import FitSettings, LabellerSettings, preset

_DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "kitti" / "object"
_STEP_M, _REACH_M = 0.02, 4.0


def frames_of(folder: Path | None, prompts: str) -> Iterator[Frame]:
    """Frames with their prompts: of a dataset, or a dozen generated ones."""
    if folder is None:
        yield from (generate(seed).frame for seed in range(12))
        return
    source = open_source(folder)
    for name in source.names:
        try:
            yield source.load(name, load_prompts(prompts, source, name))
        except InputError as error:
            print(f"left out: {error}")


def brute_force(problem: FitProblem, settings: LabellerSettings) -> float:
    """The lowest loss on the grid."""
    side = torch.arange(-_REACH_M, _REACH_M + _STEP_M / 2, _STEP_M, dtype=torch.float64)
    points = torch.from_numpy(problem.points_xz)
    valid = torch.ones(len(points), dtype=torch.bool)
    density = point_density(points, valid, settings.loss.density_radius_m)
    size = torch.tensor([problem.length_m, problem.width_m, problem.rotation_y], dtype=torch.float64)
    origin = torch.from_numpy(problem.origin_xz)
    lowest = torch.inf
    for x in side + points[:, 0].mean():
        centers = torch.stack([x.expand(len(side)), side + points[:, 1].mean()], dim=-1)
        boxes = BevBoxes(centers, size[0], size[1], size[2])
        loss = balanced_loss(points, valid, boxes, origin, settings.loss, density)
        lowest = min(lowest, float(loss.min()))
    return lowest


def final_losses(
    problems: Sequence[FitProblem], fit: FitSettings, settings: LabellerSettings
) -> tuple[Floats, float]:
    """Final losses (N,) and milliseconds per object."""
    start = time.perf_counter()
    solutions = fit_boxes(problems, fit, settings.loss, pad_to=settings.points.sample_count)
    elapsed_ms = (time.perf_counter() - start) * 1e3
    return np.array([solution.losses.total for solution in solutions]), elapsed_ms / len(problems)


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--prompts", default="label_2")
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--limit", type=int, help="only every k-th problem, so that about N remain")
    arguments = parser.parse_args()
    folder = arguments.folder or (_DEFAULT_FOLDER if _DEFAULT_FOLDER.is_dir() else None)
    settings = preset(arguments.preset)
    torch.set_num_threads(1)

    labeller = Labeller(settings)
    problems = [
        item for frame in frames_of(folder, arguments.prompts) for item in labeller.fit_problems(frame)
    ]
    if arguments.limit:
        problems = problems[:: max(1, len(problems) // arguments.limit)]
    minima = np.array([brute_force(problem, settings) for problem in problems])

    print(f"{platform.machine()}, torch {torch.__version__}, 1 thread; preset {settings.preset}")
    print(f"{len(problems)} problems (every heading hypothesis of every object)")
    adam = settings.fit.model_copy(update={"method": "adam", "adam_steps": 500})
    for name, fit in (("search", settings.fit), ("Adam, 500 steps from the centroid", adam)):
        losses, per_object_ms = final_losses(problems, fit, settings)
        ratio = losses / minima
        print(
            f"{name}: {(ratio <= 1.01).mean():.2%} within 1.01 x the brute-force minimum; "
            f"ratio median {np.median(ratio):.4f}, worst {ratio.max():.3f}; {per_object_ms:.1f} ms an object"
        )


if __name__ == "__main__":
    main()
