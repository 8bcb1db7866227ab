"""Which agent types are vehicles, pedestrians and cyclists."""

from collections.abc import Mapping, Sequence

import numpy as np
from jaxtyping import Bool
from numpy import ndarray as Array

# types by group: models control groups, and `make_layers` draws them; the colours of pictures are
# by type (`layers.TYPE_COLOURS`). All other types, motorcycles too, are OTHER
AGENT_GROUPS: Mapping[str, tuple[str, ...]] = {
    "vehicle": ("car", "van", "truck", "bus"),
    "pedestrian": ("pedestrian",),
    "cyclist": ("cyclist",),
}
OTHER = "other"


def find_group(agent_type: str) -> str:
    """Find the group of an agent type: a key of `AGENT_GROUPS`, or `OTHER`.

    >>> find_group("van"), find_group("motorcycle")
    ('vehicle', 'other')
    """
    groups = (group for group, types in AGENT_GROUPS.items() if agent_type in types)
    return next(groups, OTHER)


def select_group(agent_types: Sequence[str], group: str) -> Bool[Array, "N"]:
    """Mark the agents that belong to a group.

    >>> select_group(("car", "pedestrian", "bus"), "vehicle")
    array([ True, False,  True])
    """
    return np.array([find_group(agent_type) == group for agent_type in agent_types], bool)
