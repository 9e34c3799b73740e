"""The fit against its rivals on the same problems: how fast it is, and how low the losses that it ends at.

    python benchmarks/fit.py [FOLDER] [--prompts label_2] [--preset paper] [--repeats 3] [--brute-force 240]

FOLDER is a dataset (by default ../shared/kitti/object where it exists, else a dozen generated frames); its
problems are what the labeller hands to the fit: every heading hypothesis of every object.

- Adam: 500 steps from the mean of the points, many objects in one batch. Timed in turn with the search, all
  problems at once and frame by frame (a service has one frame at a time; few objects share Adam's steps).
- Brute force, on about N of the problems: the lowest loss on a grid of 0.02 m over +-4 m around the mean
  of the points. A fit succeeds where it ends at no more than 1.01 times that.
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
from boxlift.faithful import fit_problems
from boxlift.fit import FitProblem, fit_boxes
from boxlift.losses import BevBoxes, balanced_loss, point_density
from boxlift.settings import FitSettings, LabellerSettings, preset

_DEFAULT_FOLDER = Path(__file__).resolve().parents[2] / "shared" / "kitti" / "object"
_STEP_M, _REACH_M = 0.02, 4.0
# Losses closer than this are equal: neither of two fits is the better one.
_EQUAL = 0.01


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
    calls: Sequence[Sequence[FitProblem]], fit: FitSettings, settings: LabellerSettings
) -> tuple[Floats, float]:
    """Final losses (N,) of the problems of all calls, and milliseconds per problem."""
    start = time.perf_counter()
    solutions = [
        solution
        for problems in calls
        for solution in fit_boxes(problems, fit, settings.loss, pad_to=settings.points.sample_count)
    ]
    elapsed_ms = (time.perf_counter() - start) * 1e3
    return np.array([solution.losses.total for solution in solutions]), elapsed_ms / len(solutions)


def race(
    title: str,
    calls: Sequence[Sequence[FitProblem]],
    fits: tuple[FitSettings, FitSettings],
    settings: LabellerSettings,
    repeats: int,
) -> tuple[Floats, Floats]:
    """Time search and Adam in turn, print the medians, and return the final losses (N,) of both."""
    runs = [[final_losses(calls, fit, settings) for fit in fits] for _ in range(repeats)]
    times_ms = np.array([[elapsed_ms for _, elapsed_ms in run] for run in runs])
    search_ms, adam_ms = np.median(times_ms, axis=0)
    ratio = np.median(times_ms[:, 1] / times_ms[:, 0])
    print(
        f"{title:16} search {search_ms:6.2f}  Adam {adam_ms:6.2f} ms a problem; "
        f"Adam / search {ratio:.2f} (medians of {repeats} runs)"
    )
    return runs[0][0][0], runs[0][1][0]


def main() -> None:
    """Measure and print."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawTextHelpFormatter)
    parser.add_argument("folder", nargs="?", type=Path)
    parser.add_argument("--prompts", default="label_2")
    parser.add_argument("--preset", default="paper")
    parser.add_argument("--repeats", type=int, default=3, help="timed runs of each fit")
    parser.add_argument(
        "--brute-force", type=int, default=240, help="problems to solve by brute force; 0: none"
    )
    arguments = parser.parse_args()
    folder = arguments.folder or (_DEFAULT_FOLDER if _DEFAULT_FOLDER.is_dir() else None)
    settings = preset(arguments.preset)
    adam = settings.fit.model_copy(update={"method": "adam", "adam_steps": 500})
    torch.set_num_threads(1)

    by_frame = [fit_problems(frame, settings) for frame in frames_of(folder, arguments.prompts)]
    by_frame = [problems for problems in by_frame if problems]
    everything = [item for problems in by_frame for item in problems]
    print(f"{platform.machine()}, torch {torch.__version__}, 1 thread; preset {settings.preset}")
    print(f"{len(everything)} problems of {len(by_frame)} frames (every heading hypothesis of every object)")

    fits = (settings.fit, adam)
    race("frame by frame", by_frame, fits, settings, arguments.repeats)
    searched, descended = race("all at once", [everything], fits, settings, arguments.repeats)
    ratio = searched / descended
    print(
        f"lower final loss by more than {_EQUAL:.0%}: search in {(ratio < 1 - _EQUAL).mean():.1%}, "
        f"Adam in {(1 / ratio < 1 - _EQUAL).mean():.1%} of the problems\n"
        f"final loss, search / Adam: median {np.median(ratio):.3f}, 10th percentile "
        f"{np.percentile(ratio, 10):.3f}, 90th {np.percentile(ratio, 90):.3f}, worst {ratio.max():.4f}"
    )

    if arguments.brute_force:
        some = np.arange(0, len(everything), max(1, len(everything) // arguments.brute_force))
        minima = np.array([brute_force(everything[index], settings) for index in some])
        print(f"against brute force on {len(some)} of the problems")
        for name, losses in (("search", searched), ("Adam", descended)):
            above = losses[some] / minima
            print(
                f"{name:8} {(above <= 1.01).mean():7.2%} within 1.01 x the minimum; "
                f"ratio median {np.median(above):.4f}, worst {above.max():.3f}"
            )


if __name__ == "__main__":
    main()
