"""Agent types: their groups (vehicle, pedestrian, cyclist), typical sizes and colours."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

# types by group: a model controls one group, and `make_layers` draws each group as a layer. Types
# that are in no group, motorcycles too, are OTHER
AGENT_GROUPS: Mapping[str, tuple[str, ...]] = {
    "vehicle": ("car", "van", "truck", "bus"),
    "pedestrian": ("pedestrian",),
    "cyclist": ("cyclist",),
}
OTHER = "other"
# red, green and blue, 0 to 1; unlike the colours of lights and markings, which are yellow and white
TYPE_COLOURS: Mapping[str, tuple[float, float, float]] = {
    "car": (0.1, 0.35, 0.9),
    "van": (0.3, 0.6, 1.0),
    "truck": (0.05, 0.2, 0.6),
    "bus": (0.0, 0.45, 0.5),
    "pedestrian": (1.0, 0.1, 0.6),
    "cyclist": (0.0, 0.85, 0.85),
}
# length and width in metres of agents whose size a file does not give
TYPICAL_SIZES: Mapping[str, tuple[float, float]] = {
    "car": (4.5, 1.8),
    "van": (5.5, 2.0),
    "truck": (8.0, 2.5),
    "bus": (12.0, 2.5),
    "motorcycle": (2.1, 0.8),
    "cyclist": (1.8, 0.65),
}
OTHER_SIZE = (0.5, 0.5)
# names of agent types in datasets -> ours; all others are only written in lower case
AGENT_TYPES = {
    "bicycle": "cyclist",
    "bicyclist": "cyclist",
    "bike": "cyclist",
    "biker": "cyclist",
    "cart": "car",  # a golf cart
    "ped": "pedestrian",
    "skater": "cyclist",  # of Stanford's types the one that moves alike
    "truck_bus": "truck",
    "veh": "car",
}


def find_group(agent_type: str) -> str:
    """Find the group of an agent type: a key of `AGENT_GROUPS`, or `OTHER`.

    >>> find_group("van"), find_group("motorcycle")
    ('vehicle', 'other')
    """
    groups = (group for group, types in AGENT_GROUPS.items() if agent_type in types)
    return next(groups, OTHER)


def get_colour(agent_type: str) -> tuple[float, float, float]:
    """Get the colour in which agents of a type are drawn: red, green and blue, 0 to 1."""
    return TYPE_COLOURS.get(agent_type, (0.55, 0.2, 0.75))


def select_group(agent_types: Sequence[str], group: str) -> Bool[Array, "N"]:
    """Select the agents of a group, as a mask.

    >>> select_group(("car", "pedestrian", "bus"), "vehicle")
    array([ True, False,  True])
    """
    return np.array([find_group(agent_type) == group for agent_type in agent_types], bool)
