"""What boxlift's size priors call the classes of other data sets, for their annotations to be prompts.

What has no counterpart keeps its name, and is a class without a size unless a priors file declares one.
Sources: the taxonomies of nuScenes (category.json), Argoverse 2 (sensor data set) and Waymo (labels.proto).
"""

from __future__ import annotations

_NAMES: dict[str, tuple[str, ...]] = {
    # Waymo's vehicles are of all kinds; most are cars.
    "Car": ("vehicle.car", "regular_vehicle", "vehicle"),
    "Truck": ("vehicle.truck", "box_truck", "truck_cab", "large_vehicle", "truck"),
    "Bus": ("vehicle.bus.rigid", "vehicle.bus.bendy", "bus", "school_bus", "articulated_bus"),
    "Pedestrian": (
        *("human.pedestrian.adult", "human.pedestrian.child", "human.pedestrian.construction_worker"),
        *("human.pedestrian.police_officer", "pedestrian", "official_signaler"),
    ),
    "Cyclist": ("bicyclist", "cyclist"),
    "Motorcyclist": ("motorcyclist",),
    "Bicycle": ("vehicle.bicycle", "bicycle"),
    "Motorcycle": ("vehicle.motorcycle", "motorcycle"),
}
_BOXLIFT_NAME = {foreign: own for own, names in _NAMES.items() for foreign in names}


def boxlift_class(name: str) -> str:
    """The class of boxlift's that `name` is, in whatever case; else `name`, as one word."""
    return _BOXLIFT_NAME.get(name.lower(), name.replace(" ", "_"))
