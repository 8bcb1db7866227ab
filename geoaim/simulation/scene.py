"""A scene: a map and the agents on it as tensors, the one crossing from files to tensors."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array
from torch import Tensor

from geoaim.aim import AIM
from geoaim.errors import TracksError
from geoaim.simulation.birdview import GREY, Boxes, Ground, View, fit_ground, make_ground, render
from geoaim.tracks import Tracks
from geoaim.world import World, crs_from_world, world_from_crs

EGO = (1.0, 0.35, 0.0)
NOSE = (1.0, 1.0, 1.0)
OTHER = (0.55, 0.2, 0.75)
COLOURS: Mapping[str, tuple[float, float, float]] = {
    "car": (0.1, 0.35, 0.9),
    "van": (0.1, 0.35, 0.9),
    "truck": (0.05, 0.2, 0.6),
    "bus": (0.05, 0.2, 0.6),
    "pedestrian": (1.0, 0.85, 0.0),
    "cyclist": (0.0, 0.85, 0.85),
}
BATCH = 16  # pictures that are rendered at once


@dataclass(frozen=True, eq=False)
class Scene:
    """A map and the agents on it.

    Attributes:
        ground: the map.
        times: (T,) seconds.
        poses: (N, T, 3) x, y and heading in the map's world; NaN while absent.
        present: (N, T) whether the agent is there.
        sizes: (N, 2) length and width, metres.
        colours: (N, 3) by type.
        ids: a name for each agent.
    """

    ground: Ground
    times: Float[Tensor, "T"]
    poses: Float[Tensor, "N T 3"]
    present: Bool[Tensor, "N T"]
    sizes: Float[Tensor, "N 2"]
    colours: Float[Tensor, "N 3"]
    ids: tuple[str, ...]


def make_scene(aim: AIM, tracks: Tracks) -> Scene:
    """A map with tracks, brought into the map's world; grey where the map shows nothing.

    Raises:
        ValueError: the map is not affine; `geoaim.aim.rectify` it.
        TracksError: only one of both has a place on the Earth, or no track touches the map.
    """
    poses = _poses_in(tracks, aim.world)
    low, high = aim.corners.min(axis=0), aim.corners.max(axis=0)
    places = poses[tracks.present][:, :2]
    if not ((places > low) & (places < high)).all(axis=1).any():
        raise TracksError(
            f"no track touches the map: they lie between {_said(places.min(axis=0))} and "
            f"{_said(places.max(axis=0))} m, the map between {_said(low)} and {_said(high)} m. "
            "Are both of one place?"
        )
    colours = [COLOURS.get(kind, OTHER) for kind in tracks.types]
    return Scene(
        ground=ground_of(aim),
        times=torch.tensor(tracks.times, dtype=torch.float32),
        poses=torch.tensor(poses, dtype=torch.float32),
        present=torch.tensor(tracks.present),
        sizes=torch.tensor(tracks.sizes, dtype=torch.float32),
        colours=torch.tensor(colours, dtype=torch.float32),
        ids=tracks.ids,
    )


def ground_of(aim: AIM) -> Ground:
    """The map's image as a texture.

    Raises:
        ValueError: the map is not affine; `geoaim.aim.rectify` it.
    """
    if not aim.is_affine:
        raise ValueError("the map's transform is not affine; use geoaim.aim.rectify first")
    image = torch.tensor(aim.image).permute(2, 0, 1) / 255
    image = torch.where(torch.tensor(aim.coverage > 0), image, GREY)
    image_from_world = np.linalg.inv(aim.world_from_image)[:2]
    return make_ground(image, torch.tensor(image_from_world, dtype=torch.float32))


def agent_number(scene: Scene, name: str) -> int:
    """The row of an agent.

    Raises:
        TracksError: there is none of that name.
    """
    if name not in scene.ids:
        some = ", ".join(scene.ids[:8]) + (", ..." if len(scene.ids) > 8 else "")
        raise TracksError(f"there is no agent {name!r} among {len(scene.ids)}: {some}")
    return scene.ids.index(name)


def boxes_at(scene: Scene, steps: Int[Tensor, "B"], egos: Int[Tensor, "B"]) -> Boxes:
    """All agents at each of B steps, one of them in the ego's colour."""
    present = scene.present[:, steps].t()
    poses = scene.poses[:, steps].transpose(0, 1)
    colours = scene.colours.repeat(len(steps), 1, 1)
    colours[torch.arange(len(steps)), egos] = colours.new_tensor(EGO)
    noses = colours.new_tensor(NOSE).expand_as(colours)
    return Boxes(poses, scene.sizes, colours, present, noses)


def step_at(scene: Scene, agent: int, time: float | None) -> Int[Tensor, ""]:
    """The step at which an agent is there, nearest to a time in seconds; its first one for None.

    Raises:
        TracksError: it is not there within a second of that time.
    """
    steps = scene.present[agent].nonzero()[:, 0]
    times = scene.times[steps]
    nearest = 0 if time is None else int((times - time).abs().argmin())
    if time is not None and abs(float(times[nearest]) - time) > 1:
        raise TracksError(
            f"agent {scene.ids[agent]} is there from {float(times[0]):g} to {float(times[-1]):g} s,"
            f" not at {time:g} s"
        )
    return steps[nearest]


def film_agent(
    scene: Scene, agent: int, view: View, steps: Int[Tensor, "S"]
) -> Iterator[UInt8[Array, "H W 3"]]:
    """What an agent has around it at some steps at which it is there, for people's eyes."""
    ground = fit_ground(scene.ground, view.resolution)
    for some in torch.split(steps, BATCH):
        boxes = boxes_at(scene, some, torch.full_like(some, agent))
        with torch.no_grad():
            pictures = render(view, scene.poses[agent, some], ground, [boxes])
        for picture in (pictures.clamp(0, 1) * 255).round().to(torch.uint8):
            yield np.ascontiguousarray(picture.permute(1, 2, 0).numpy())


def _poses_in(tracks: Tracks, world: World) -> Float[Array, "N T 3"]:
    """x, y and heading in another world."""
    poses, there = tracks.states[..., :3].copy(), tracks.present
    if (tracks.world.crs is None) != (world.crs is None):
        raise TracksError(
            f"the map lies in {world.crs or 'a plane of its own'} and the tracks in "
            f"{tracks.world.crs or 'a plane of their own'}; give both a place on the Earth, or none"
        )
    heading = poses[there, 2]
    here = poses[there, :2]
    ahead = here + np.stack([np.cos(heading), np.sin(heading)], axis=1)
    here, ahead = (_moved(points, tracks.world, world) for points in (here, ahead))
    poses[there, :2] = here
    poses[there, 2] = np.arctan2(*(ahead - here).T[::-1])
    return poses


def _moved(points: Float[Array, "m 2"], before: World, after: World) -> Float[Array, "m 2"]:
    return world_from_crs(after, crs_from_world(before, points), before.crs)


def _said(place: Float[Array, "2"]) -> str:
    return f"({place[0]:.0f}, {place[1]:.0f})"
