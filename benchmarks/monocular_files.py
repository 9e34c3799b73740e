"""Exported models end to end, image to boxes: what the smaller variant loses.

    boxlift export RUNS/lifter_B --out B.onnx                     (writes B_small.onnx beside it)
    python benchmarks/monocular_files.py KITTI RUNS B B.onnx B_small.onnx

Judged on the frames of a fold that the run was not trained on, and on the sequence that goes with it.
"""

from __future__ import annotations

import argparse
from pathlib import Path

import numpy as np

from boxlift.camera import Calibration
from boxlift.formats.kitti_label import objects_of
from boxlift.monocular import Monocular
from monocular import fold, score

_SEQUENCE_OF = {"A": "0009", "B": "0005"}


def main() -> None:
    """Print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("kitti", type=Path)
    parser.add_argument("runs", type=Path)
    parser.add_argument("fold", choices=sorted(_SEQUENCE_OF))
    parser.add_argument("files", type=Path, nargs="+")
    options = parser.parse_args()
    frames = [
        judged
        for sequence in (None, _SEQUENCE_OF[options.fold])
        for judged in fold(options.fold, options.kitti, options.runs, sequence).own
    ]
    print(
        "| file | MB | BEV@.5 easy/moderate/hard | 3D@.5 | recall | depth error |\n|---|---|---|---|---|---|"
    )
    for path in options.files:
        model = Monocular.open(path)
        found = [
            objects_of(
                model.detect(
                    judged.frame.name,
                    judged.frame.read_image(),
                    Calibration(judged.frame.image_P_cam, np.eye(4)),
                )
            )
            for judged in frames
        ]
        whole = score([judged.truth for judged in frames], found)
        bev, volume = (
            "/".join(f"{value:.1f}" for value in whole.ap[metric, 0.5]) for metric in ("bev", "3d")
        )
        size = path.stat().st_size / 1e6
        print(
            f"| {path.name} | {size:.1f} | {bev} | {volume} | {whole.recall:.3f} | {whole.depth_error:.4f} |"
        )


if __name__ == "__main__":
    main()
