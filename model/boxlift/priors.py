"""Frozen sizes per class, each with a source that is not a 3D label."""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class SizePrior:
    """The frozen size of a class in metres, and where it comes from."""

    height_m: float
    width_m: float
    length_m: float
    source: str


SIZE_PRIORS: dict[str, SizePrior] = {
    "Car": SizePrior(1.6, 1.8, 4.0, "WeakM3D, section 4.1, 'Implementation Details'."),
    "Van": SizePrior(
        1.97, 1.90, 4.90, "Volkswagen Transporter T5, short wheelbase: manufacturer's data sheet, rounded."
    ),
    "Truck": SizePrior(
        3.4,
        2.5,
        8.5,
        "12-16 t rigid delivery truck with box body (class of the Mercedes-Benz Atego 1323 L): "
        "manufacturers' body guides; width within the 2.55 m limit of Directive 96/53/EC.",
    ),
    "Pedestrian": SizePrior(
        1.70,
        0.60,
        0.60,
        "Adult body height and the 0.6 m body ellipse of Fruin, 'Pedestrian Planning and Design' (1971).",
    ),
    "Cyclist": SizePrior(
        1.75,
        0.65,
        1.80,
        "City bicycle of 1.8 m with a 0.65 m handlebar and a seated adult: "
        "dimensions of ISO 4210 city bicycles and CROW, 'Design Manual for Bicycle Traffic' (2016).",
    ),
}
