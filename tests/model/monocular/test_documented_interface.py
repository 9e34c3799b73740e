from __future__ import annotations

from pathlib import Path

from boxlift.monocular import MONOCULAR

DOCUMENT = Path(__file__).resolve().parents[3] / "docs" / "monocular.md"


def test_the_document_names_every_tensor_with_its_type_and_every_property() -> None:
    rows = [[cell.strip() for cell in line.split("|")] for line in DOCUMENT.read_text().splitlines()]
    documented = {(row[1], row[2], row[3], row[4]) for row in rows if len(row) == 7}
    for role, tensors in (("input", MONOCULAR.inputs), ("output", MONOCULAR.outputs)):
        for tensor in tensors:
            shape = ", ".join(str(side) for side in tensor.shape)
            shape = f"({shape},)" if len(tensor.shape) == 1 else f"({shape})"
            assert (role, f"`{tensor.name}`", tensor.type_names[0], shape) in documented
    for name in MONOCULAR.metadata:
        assert any(row[:2] == ("metadata", f"`{name}`") for row in documented)
