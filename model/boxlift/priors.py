"""Frozen sizes per class, each with a source that is not a 3D label.

A user's own classes lie over these: see formats/size_priors.py and LabellerSettings.sizes.
"""

from __future__ import annotations

from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

# A class is one word of a KITTI line.
ClassName = Annotated[str, Field(pattern=r"^[\w.+-]{1,100}$")]


class _Size(BaseModel):
    """Metres and their source; what lies outside the ranges (ours) is another unit or no road user."""

    model_config = ConfigDict(frozen=True, extra="forbid", allow_inf_nan=False)

    height_m: float = Field(ge=0.1, le=10, description="Height in metres.")
    width_m: float = Field(ge=0.1, le=10, description="Width in metres, without mirrors.")
    length_m: float = Field(ge=0.1, le=50, description="Length in metres.")
    source: str = Field(
        max_length=500,
        pattern=r"\S",
        description="Where the size comes from; never a statistic of 3D labels.",
    )


class SizeTemplate(_Size):
    """One common member of a class, e.g. the estate among cars."""

    name: str = Field(min_length=1, max_length=100, description="What it is called.")


class SizePrior(_Size):
    """The frozen size of a class."""

    templates: tuple[SizeTemplate, ...] = Field(
        (),
        max_length=20,
        description="Sizes that members of the class commonly have; `accurate` starts from the first.",
    )
    spread: tuple[float, float, float] = Field(
        (0.15, 0.15, 0.15),
        description="How far length, width and height may lie off, as shares (standard deviations, ours).",
    )


def _template(name: str, height_m: float, width_m: float, length_m: float, source: str) -> SizeTemplate:
    return SizeTemplate(name=name, height_m=height_m, width_m=width_m, length_m=length_m, source=source)


# Common cars of about 2011 in Europe. The manufacturers' data are quoted from where we could read them.
_CARS = (
    _template(
        "typical",
        1.49,
        1.69,
        4.03,
        "Fiat Grande Punto (2005): 4.03 m long, 1.49 m high, 1.68 m wide (motorlegend.com and MotorBox, at "
        "the presentation; 1.69 is ours, after an unchecked 1687 mm); a Renault Clio III has 4.0 m, 1.49 m "
        "and 1.71 m (motorlegend.com).",
    ),
    _template(
        "supermini",
        1.47,
        1.68,
        3.97,
        "Volkswagen Polo V (2009): length and height from the differences to its successor's 4053 and "
        "1461 mm (Wikipedia, 'Volkswagen Polo Mk6'), width 1682 mm (vicky.in, at the presentation).",
    ),
    _template(
        "hatchback", 1.48, 1.79, 4.20, "Volkswagen Golf VI (2008): 1479 x 1785 x 4199 mm (GoAuto, 'Golf VI')."
    ),
    _template(
        "saloon",
        1.47,
        1.82,
        4.77,
        "Volkswagen Passat B6/B7 (2005): 1473 x 1820 x 4765 mm (Wikipedia, 'Volkswagen Passat (B6)'); "
        "a BMW 3 Series E90 has 1420 x 1816 x 4526 mm (Wikipedia).",
    ),
    _template(
        "estate",
        1.52,
        1.82,
        4.77,
        "Volkswagen Passat Variant B6/B7 (2005): 1516 x 1820 x 4775 mm (Wikipedia, as the saloon).",
    ),
    _template(
        "SUV", 1.67, 1.81, 4.43, "Volkswagen Tiguan I (2007): 1.67 x 1.81 x 4.43 m (its press release)."
    ),
)

SIZE_PRIORS: dict[str, SizePrior] = {
    "Car": SizePrior(
        height_m=1.6,
        width_m=1.8,
        length_m=4.0,
        source="WeakM3D, section 4.1, 'Implementation Details'.",
        templates=_CARS,
    ),
    "Van": SizePrior(
        height_m=1.97,
        width_m=1.90,
        length_m=4.90,
        source="Volkswagen Transporter/Caravelle T5, short wheelbase: length 4892 mm (Autocar, 'Volkswagen "
        "Caravelle 2003-2015'), rounded; height and width are ours, its data sheet is unchecked.",
    ),
    "Truck": SizePrior(
        height_m=3.4,
        width_m=2.5,
        length_m=8.5,
        source="A rigid delivery truck of 12 to 16 t with a box body. Ours, unchecked against a data sheet; "
        "within the 4.00 x 2.55 x 12.00 m of Directive 96/53/EC, annex I.",
        spread=(0.3, 0.15, 0.15),
    ),
    "Pedestrian": SizePrior(
        height_m=1.70,
        width_m=0.60,
        length_m=0.60,
        source="Body ellipse of 0.5 x 0.6 m (FHWA-RD-98-107, section 2.1, after Fruin, 1971), both sides "
        "0.6 m as arms and legs swing; the height is an adult's, rounded (ours).",
    ),
    "Cyclist": SizePrior(
        height_m=1.75,
        width_m=0.65,
        length_m=1.80,
        source="Typical bicycle: 1.5 to 1.8 m long, handlebar 0.61 m wide (Minnesota DOT, 'Bikeway Facility "
        "Design Manual', section 3-2.0); width with elbows and the height of the rider are ours.",
    ),
}
