"""What more data would bring: the shipped head trained on fewer frames, and on fewer drives.

    python benchmarks/learning_curve.py KITTI RUNS      (RUNS: see benchmarks/monocular_runs.py)

Small heads of equal size and equally many steps. Both folds; figures are of their judged frames together,
with the detector's 2D boxes. Subsets are drawn twice, and the mean is told. The drives of the smaller
sets come first in an order by chance; `unknown` and `test` frames are of a drive each.
"""

from __future__ import annotations

import argparse
from dataclasses import dataclass
from pathlib import Path

import numpy as np
import torch

from boxlift.network.config import LifterModelSettings, LifterSettings
from boxlift.network.lifter import Lifter
from boxlift.network.lifter_loss import lifter_loss
from boxlift.network.lifter_rows import Rows, rows_of_frame
from boxlift.network.lifter_task import FrozenTrunk, build_lifter, lift_frame
from boxlift.network.tasks import read_config
from boxlift.network.training_frames import load_frames
from monocular import fold, score
from monocular_runs import frames_of

_STEPS, _BATCH, _LEARNING_RATE = 600, 256, 1.5e-3
_HEAD = LifterModelSettings(blind_voices=1, seeing_voices=1)
_FRAME_SHARES = (0.125, 0.25, 0.5, 1.0)
_DRIVE_COUNTS = (1, 2, 4)
_DRAWS = 2


@dataclass(frozen=True)
class Material:
    """What a fold may be trained on: rows and drive of every frame."""

    rows: list[Rows]
    drives: list[str]


def material(name: str, kitti: Path, runs: Path, trunk: FrozenTrunk) -> Material:
    """All rows of a fold, in one view less than what ships."""
    settings = read_config(runs / f"lifter_{name}.toml").settings
    assert isinstance(settings, LifterSettings)
    frames = load_frames(settings.data.train, settings.data, runs / f"lifter_{name}" / "targets.npz")
    drive_of = {frame.name: frame.drive for frame in frames_of(kitti)}
    how = settings.rows.model_copy(update={"views": 2})
    rows = [rows_of_frame(frame, trunk, how, settings.augmentation, 0) for frame in frames]
    return Material(rows, [drive_of[frame.name] for frame in frames])


def trained_on(rows: Rows, seed: int) -> Lifter:
    """A head after a fixed number of steps."""
    torch.manual_seed(seed)
    head = build_lifter(_HEAD)
    sample = rows.rois[:2000].float()
    head.mean.copy_(sample.mean((0, 2, 3), keepdim=True))
    head.deviation.copy_(sample.std((0, 2, 3), keepdim=True).clamp(min=1e-3))
    optimizer = torch.optim.AdamW(head.parameters(), lr=_LEARNING_RATE, weight_decay=0.02)
    schedule = torch.optim.lr_scheduler.OneCycleLR(
        optimizer, _LEARNING_RATE, total_steps=_STEPS, pct_start=0.1
    )
    for _ in range(_STEPS):
        batch = rows.of(torch.randint(len(rows), (_BATCH,)))
        loss = sum(lifter_loss(head(batch.geometry, batch.rois.float()), batch).values())
        assert isinstance(loss, torch.Tensor)
        optimizer.zero_grad()
        torch.autograd.backward(loss)
        optimizer.step()
        schedule.step()
    return head.eval()


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kitti", type=Path)
    parser.add_argument("runs", type=Path)
    options = parser.parse_args()
    torch.set_num_threads(1)
    trunk = FrozenTrunk()
    materials = {name: material(name, options.kitti, options.runs, trunk) for name in "AB"}
    judged = {name: fold(name, options.kitti, options.runs, None).own for name in "AB"}
    print(
        "| trained on | frames A, B | drives A, B | BEV@.5 | 3D@.5 | depth error |\n|---|---|---|---|---|---|"
    )
    subsets: list[tuple[str, float | None, int | None]] = []
    subsets += [(f"{share:.3g} of the frames", share, None) for share in _FRAME_SHARES]
    subsets += [(f"{count} drives, all their frames", None, count) for count in _DRIVE_COUNTS]
    for title, share, count in subsets:
        figures, frames, drives = [], dict.fromkeys("AB", 0.0), dict.fromkeys("AB", 0.0)
        draws = 1 if share == 1 else _DRAWS
        for draw in range(draws):
            truths, found = [], []
            for name, of_fold in materials.items():
                chosen = _chosen(of_fold, share, count, draw)
                frames[name] += len(chosen) / draws
                drives[name] += len({of_fold.drives[index] for index in chosen}) / draws
                head = trained_on(Rows.joined([of_fold.rows[index] for index in chosen]), draw)
                truths += [frame.truth for frame in judged[name]]
                found += [lift_frame(head, trunk, frame.frame) for frame in judged[name]]
            figures.append(score(truths, found).figures)
        bev, volume, _, depth = np.mean(figures, axis=0)
        cells = [f"{part['A']:.0f}, {part['B']:.0f}" for part in (frames, drives)]
        print(f"| {title} | {' | '.join(cells)} | {bev:.1f} | {volume:.1f} | {depth:.3f} |", flush=True)


def _chosen(material: Material, share: float | None, count: int | None, draw: int) -> list[int]:
    """Indices of frames: a share of them, or all of some drives."""
    rng = np.random.default_rng(draw)
    if share is not None:
        total = len(material.rows)
        return sorted(rng.permutation(total)[: max(1, round(share * total))].tolist())
    drives = rng.permutation(sorted(set(material.drives)))[:count].tolist()
    return [index for index, drive in enumerate(material.drives) if drive in drives]


if __name__ == "__main__":
    main()
