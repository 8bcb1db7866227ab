"""Which agents are known surely enough to predict them, and why others are left out."""

from collections import Counter
from collections.abc import Mapping

import torch
from jaxtyping import Bool
from torch import Tensor

from geoaim.rendering.scene import Scene
from geoaim.tracks.agent_types import select_group

# m/s; standard deviation of an observed speed up to which an agent is predicted. Errors grow with
# it alike at all speeds: by 0.6 to 1 m for each m/s over a vehicle's 4 s, by 1.3 to 1.7 m over a
# pedestrian's 8 s. With 1 m/s those of what moves are 1.3 to 2 times as large as with exact speeds
# (`python -m benchmarks.prediction unsure_speeds`)
MAX_SPEED_SIGMA = 1.0
UNSURE = f"their speed is known no better than to {MAX_SPEED_SIGMA:g} m/s (1 sigma)"
UNKNOWN = "their heading or speed is not known yet"


def mark_sure(scene: Scene) -> Bool[Tensor, "N T"]:
    """Mark where an agent's state is known from the past alone, and surely enough to predict it."""
    known = scene.present & torch.isfinite(scene.observed).all(dim=2)
    if scene.observed_sigma is None:
        return known
    return known & ~(scene.observed_sigma > MAX_SPEED_SIGMA)


def list_left_out(scene: Scene, group: str, start: int) -> dict[str, str]:
    """List the agents of a group that are there at a step and are not predicted, and why, by id."""
    there = torch.from_numpy(select_group(scene.types, group)).to(scene.present.device)
    left = there & scene.present[:, start] & ~mark_sure(scene)[:, start]
    known = torch.isfinite(scene.observed[:, start]).all(dim=1)
    return {scene.ids[k]: UNSURE if known[k] else UNKNOWN for k in left.nonzero()[:, 0].tolist()}


def describe_left_out(reasons: Mapping[str, str]) -> str:
    """Describe how many agents are left out, and why.

    >>> describe_left_out({"3": UNKNOWN, "5": UNKNOWN})
    '2 since their heading or speed is not known yet'
    """
    counts = Counter(reasons.values()).items()
    return ", ".join(f"{count} since {reason}" for reason, count in counts)
