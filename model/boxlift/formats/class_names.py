"""What a class is called where: for labels of one data set to be judged by the rules of another, written in
its format, or taken as prompts.

Sources: docs/labeling_specifications.md of the Waymo Open Dataset (motorcycles and their riders are vehicles,
trains and trams are not, a bicycle without rider is not labelled); nuscenes/eval/detection/utils.py of the
nuScenes devkit (category_to_detection_name); the taxonomy of the Argoverse 2 sensor data set. Names are
compared in lower case.
"""

from __future__ import annotations

WAYMO_CLASSES = ("Vehicle", "Pedestrian", "Cyclist", "Sign")

NUSCENES_CLASSES = (
    *("car", "truck", "bus", "trailer", "construction_vehicle"),
    *("pedestrian", "motorcycle", "bicycle", "traffic_cone", "barrier"),
)

_WAYMO_NAMES: dict[str, tuple[str, ...]] = {
    "Vehicle": (
        *("type_vehicle", "car", "van", "truck", "bus", "trailer", "construction_vehicle", "motorcycle"),
        *("motorcyclist", "regular_vehicle", "large_vehicle", "box_truck", "truck_cab", "school_bus"),
        *("articulated_bus", "vehicular_trailer", "message_board_trailer"),
    ),
    "Pedestrian": ("type_pedestrian", "person", "person_sitting", "official_signaler"),
    "Cyclist": ("type_cyclist", "bicyclist"),
    "Sign": ("type_sign", "stop_sign"),
}

_NUSCENES_NAMES: dict[str, tuple[str, ...]] = {
    "car": ("vehicle.car", "van", "regular_vehicle"),
    "truck": ("vehicle.truck", "box_truck", "truck_cab"),
    "bus": ("vehicle.bus.bendy", "vehicle.bus.rigid", "school_bus", "articulated_bus"),
    "trailer": ("vehicle.trailer", "vehicular_trailer"),
    "construction_vehicle": ("vehicle.construction",),
    "pedestrian": (
        *("human.pedestrian.adult", "human.pedestrian.child", "human.pedestrian.construction_worker"),
        *("human.pedestrian.police_officer", "person", "person_sitting"),
    ),
    "motorcycle": ("vehicle.motorcycle", "motorcyclist"),
    "bicycle": ("vehicle.bicycle", "cyclist", "bicyclist"),
    "traffic_cone": ("movable_object.trafficcone", "construction_cone"),
    "barrier": ("movable_object.barrier",),
}

BICYCLE_RACKS = ("static_object.bicycle_rack", "bicycle_rack")


def _index(classes: tuple[str, ...], names: dict[str, tuple[str, ...]]) -> dict[str, int]:
    return {name.lower(): index for index, own in enumerate(classes) for name in (own, *names.get(own, ()))}


_WAYMO_INDEX = _index(WAYMO_CLASSES, _WAYMO_NAMES)
_NUSCENES_INDEX = _index(NUSCENES_CLASSES, _NUSCENES_NAMES)


def waymo_class(name: str) -> int | None:
    """Index in WAYMO_CLASSES of what a label calls `name`; None where Waymo has no such class."""
    return _WAYMO_INDEX.get(name.lower())


def nuscenes_class(name: str) -> int | None:
    """Index in NUSCENES_CLASSES of what a label calls `name`; None where nuScenes does not judge it."""
    return _NUSCENES_INDEX.get(name.lower())


# What boxlift's size priors call the classes of others.
_BOXLIFT_NAMES: dict[str, tuple[str, ...]] = {
    # Waymo's vehicles are of all kinds; most are cars.
    "Car": ("vehicle.car", "regular_vehicle", "vehicle"),
    "Truck": ("vehicle.truck", "box_truck", "truck_cab", "large_vehicle"),
    "Bus": ("vehicle.bus.rigid", "vehicle.bus.bendy", "school_bus", "articulated_bus"),
    "Pedestrian": (
        *("human.pedestrian.adult", "human.pedestrian.child", "human.pedestrian.construction_worker"),
        *("human.pedestrian.police_officer", "official_signaler"),
    ),
    "Cyclist": ("bicyclist",),
    "Motorcyclist": (),
    "Bicycle": ("vehicle.bicycle",),
    "Motorcycle": ("vehicle.motorcycle",),
}
_BOXLIFT_NAME = {name.lower(): own for own, names in _BOXLIFT_NAMES.items() for name in (own, *names)}

_ARGOVERSE2_NAMES = {
    "car": "REGULAR_VEHICLE",
    "van": "REGULAR_VEHICLE",
    "truck": "TRUCK",
    "bus": "BUS",
    "pedestrian": "PEDESTRIAN",
    "person": "PEDESTRIAN",
    "person_sitting": "PEDESTRIAN",
    "cyclist": "BICYCLIST",
    "motorcyclist": "MOTORCYCLIST",
    "bicycle": "BICYCLE",
    "motorcycle": "MOTORCYCLE",
}


def boxlift_class(name: str, attribute: str | None = None) -> str:
    """The class of boxlift's that `name` is; else `name`, as one word: a class without a size.

    attribute: nuScenes'. What is ridden there is a bicycle or motorcycle with a rider in its box.
    """
    if attribute == "cycle.with_rider":
        return "Cyclist"
    return _BOXLIFT_NAME.get(name.lower(), name.replace(" ", "_"))


def argoverse2_class(name: str) -> str:
    """What Argoverse 2 calls the class; else `name` in its capitals."""
    return _ARGOVERSE2_NAMES.get(name.lower(), name.upper().replace(" ", "_"))
