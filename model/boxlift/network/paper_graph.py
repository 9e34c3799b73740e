"""A trained PaperNetwork as the graph that `boxlift detect` and `/detect` read (boxlift.monocular.interface).

Where no prompts come along, the 2D detector of the package finds the objects inside the graph.
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import torch
from torch import Tensor, nn
from torch.nn import functional

from boxlift.detector import DEFAULT_FILE
from boxlift.network import onnx_files
from boxlift.network.backbones import MULTIPLE
from boxlift.network.box_parameters import to_boxes
from boxlift.network.detections import CLASSES, COCO_INDICES
from boxlift.network.graphs import DetectorGraph
from boxlift.network.nanodet import NanoDetHead, NanoDetTrunk
from boxlift.network.paper_head import PaperNetwork
from boxlift.network.targets import frozen_sizes

# The paper's network does not say how sure it is of a depth: about what it is off by on unseen drives (ours).
_DEPTH_SPREAD = 0.08
_MIN_SCORE = 0.1
_INPUTS = ("image", "image_P_cam", "prompt_boxes_px", "prompt_categories")
_OUTPUTS = (
    "boxes_px",
    "categories",
    "detection_scores",
    "centers_cam",
    "sizes_m",
    "rotations_y",
    "depth_spread",
    "scores",
)


class PaperGraph(nn.Module):
    """A PaperNetwork with a 2D detector beside it; inputs and outputs are those of the interface."""

    def __init__(self, network: PaperNetwork, categories: tuple[str, ...]) -> None:
        """Raises KeyError where the detector in the package is not what it was made from."""
        super().__init__()
        self.network = network
        self.detector = DetectorGraph(NanoDetTrunk(), NanoDetHead(len(COCO_INDICES)), _MIN_SCORE)
        onnx_files.load_weights(self.detector, onnx_files.read_weights(DEFAULT_FILE), "")
        ours = [categories.index(name) if name in categories else -1 for name in CLASSES]
        self.register_buffer("category_of", torch.tensor(ours), persistent=False)
        sizes = torch.from_numpy(frozen_sizes(categories)).float()
        self.register_buffer("frozen_size_m", sizes, persistent=False)
        self.category_of: Tensor
        self.frozen_size_m: Tensor

    def forward(
        self, image: Tensor, image_P_cam: Tensor, prompt_boxes_px: Tensor, prompt_categories: Tensor
    ) -> tuple[Tensor, ...]:
        """See boxlift.monocular.interface."""
        found_px, found_score, found_class = self.detector(image)
        found_category = self.category_of[found_class]
        # What was found counts where nothing was asked for.
        asked = torch.ones_like(prompt_categories)
        counts = (found_category >= 0) & (asked.sum() == 0)
        rows = torch.cat([asked > 0, counts]).nonzero()[:, 0]
        boxes_px = torch.cat([prompt_boxes_px, found_px])[rows]
        category = torch.cat([prompt_categories, found_category])[rows]
        score = torch.cat([torch.ones_like(prompt_boxes_px[:, 0]), found_score])[rows]
        size_m = self.frozen_size_m[category]
        parameters = self.network(_padded(image), image_P_cam[None], [boxes_px], [size_m])
        boxes = to_boxes(parameters, image_P_cam, size_m)
        return (
            boxes_px,
            category,
            score,
            boxes.center_cam,
            boxes.size_m,
            boxes.rotation_y,
            torch.full_like(score, _DEPTH_SPREAD),
            score.clone(),
        )


def export_paper_network(
    network: PaperNetwork, categories: tuple[str, ...], path: Path, description: dict[str, Any]
) -> None:
    """Write the ONNX file. description: what its metadata say besides, e.g. training_data and licence."""
    graph = PaperGraph(network, categories).eval()
    example = [
        torch.zeros((375, 1242, 3), dtype=torch.uint8),
        torch.tensor([[721.5, 0, 609.6, 44.9], [0, 721.5, 172.9, 0.2], [0, 0, 1, 0.003]]),
        torch.tensor([[100.0, 150, 200, 220], [600, 160, 650, 200], [900, 150, 1100, 300]]),
        torch.zeros(3, dtype=torch.int64),
    ]
    free = [{0: "height", 1: "width"}, {}, {0: "prompts"}, {0: "prompts"}]
    model = onnx_files.export(graph, example, _INPUTS, _OUTPUTS, free)
    onnx_files.store_small(model)
    metadata = {
        "boxlift_interface": "monocular/1",
        "classes": list(categories),
        "focal_px": str(round(float(network.focal_px), 2)),
        "heading_period": "pi",
        "sizes_m": dict(zip(categories, frozen_sizes(categories).tolist(), strict=True)),
        **description,
    }
    onnx_files.write(model, path, metadata)


def _padded(image: Tensor) -> Tensor:
    height, width = image.shape[0], image.shape[1]
    pixels = image.permute(2, 0, 1)[None].to(torch.float32)
    return functional.pad(pixels, (0, -width % MULTIPLE, 0, -height % MULTIPLE))
