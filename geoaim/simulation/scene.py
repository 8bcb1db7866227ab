"""A scene: a map, agents and lights as tensors; the one crossing from files to tensors."""

from dataclasses import dataclass, replace

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from shapely import MultiPolygon
from torch import Tensor

from geoaim.aim import AIM
from geoaim.errors import MapError, TracksError
from geoaim.hdmap.drivable import sample_lane_directions
from geoaim.hdmap.lanelet2 import HDMap
from geoaim.hdmap.signed_distance import compute_signed_distance
from geoaim.lights import UNKNOWN, Lights, find_light_states
from geoaim.rectification import rectify
from geoaim.simulation.ground import Ground, make_ground, on_device
from geoaim.simulation.infractions import Drivable, Lanes
from geoaim.track_changes import to_world
from geoaim.tracks import Tracks
from geoaim.world import World, crs_from_world, world_from_crs

FURTHEST = 10_000.0  # m from the world's origin at which float32 still tells millimetres


@dataclass(frozen=True, eq=False)
class Scene:
    """A map, the agents and the lights on it.

    Attributes:
        ground: the map.
        times: (T,) seconds.
        poses: (N, T, 3) x, y and heading in the map's world; NaN while absent.
        speeds: (N, T) m/s, negative in reverse; NaN while absent.
        present: (N, T) whether the agent is there.
        sizes: (N, 2) length and width, metres.
        types: what each agent is.
        ids: a name for each agent.
        stop_lines: (L, 2, 2) both ends of the stop line of each light, metres.
        light_states: (T, L) as in `geoaim.lights`.
    """

    ground: Ground
    times: Float[Tensor, "T"]
    poses: Float[Tensor, "N T 3"]
    speeds: Float[Tensor, "N T"]
    present: Bool[Tensor, "N T"]
    sizes: Float[Tensor, "N 2"]
    types: tuple[str, ...]
    ids: tuple[str, ...]
    stop_lines: Float[Tensor, "L 2 2"]
    light_states: Int[Tensor, "T L"]


def scene_on(scene: Scene, device: torch.device | str) -> Scene:
    """The same scene on another device."""
    names = ("times", "poses", "speeds", "present", "sizes", "stop_lines", "light_states")
    moved = {name: getattr(scene, name).to(device) for name in names}
    return replace(scene, ground=on_device(scene.ground, device), **moved)


def scene_steps(scene: Scene, some: slice) -> Scene:
    """Some of a scene's steps."""
    return replace(
        scene,
        times=scene.times[some],
        poses=scene.poses[:, some],
        speeds=scene.speeds[:, some],
        present=scene.present[:, some],
        light_states=scene.light_states[some],
    )


def make_scene(aim: AIM, tracks: Tracks, lights: Lights | None = None) -> Scene:
    """Bring a map, tracks and lights into the map's world, as tensors.

    Args:
        aim: the map.
        tracks: of the agents.
        lights: None for a scene without traffic lights.

    Returns:
        The scene at the tracks' times. Its map is grey where the AIM has no coverage.

    Raises:
        TracksError: only some of the three are georeferenced, no track or no stop line touches the
            map, or the lights' states begin after the tracks end.
        MapError: the map lies too far from its world's origin.
    """
    tracks = to_world(tracks, aim.world)
    poses = tracks.states[..., :3]
    _check_near("map", aim.corners)
    low, high = aim.corners.min(axis=0), aim.corners.max(axis=0)
    if not tracks.present.any():
        raise TracksError("nobody is present in the tracks")
    check_touches("track", poses[tracks.present][:, :2], low, high)
    lines, states = np.empty((0, 2, 2)), np.empty((len(tracks.times), 0), np.int8)
    if lights is not None:
        if (lights.world.crs is None) != (aim.world.crs is None):
            raise TracksError(
                f"the map lies in {aim.world.crs or 'a plane of its own'} and the lights in "
                f"{lights.world.crs or 'a plane of their own'}; give both a place on the Earth"
            )
        lines = _moved(lights.lines.reshape(-1, 2), lights.world, aim.world).reshape(-1, 2, 2)
        states = find_light_states(lights, tracks.times)
        check_touches("stop line", lines.reshape(-1, 2), low, high)
        if (states == UNKNOWN).all():
            raise TracksError(
                f"the lights' states are told from {lights.times[0]:g} s on, the tracks end at "
                f"{tracks.times[-1]:g} s. Are both of one recording?"
            )
    return Scene(
        ground=ground_of(aim),
        times=torch.tensor(tracks.times),
        poses=torch.tensor(poses, dtype=torch.float32),
        speeds=torch.tensor(tracks.states[..., 3], dtype=torch.float32),
        present=torch.tensor(tracks.present),
        sizes=torch.tensor(tracks.sizes, dtype=torch.float32),
        types=tracks.types,
        ids=tracks.ids,
        stop_lines=torch.tensor(lines, dtype=torch.float32),
        light_states=torch.tensor(states),
    )


def ground_of(aim: AIM) -> Ground:
    """The map's image as a texture; north up where a tilted camera saw it."""
    if not aim.is_affine:
        aim = rectify(aim)
    image = torch.tensor(aim.image).permute(2, 0, 1) / 255
    image_from_world = torch.tensor(np.linalg.inv(aim.world_from_image)[:2], dtype=torch.float32)
    return make_ground(image, image_from_world, known=torch.tensor(aim.coverage > 0))


def drivable_of(area: MultiPolygon, *, resolution: float = 0.2) -> Drivable:
    """How far points of the world are from the edge of where vehicles may drive.

    Raises:
        MapError: the area lies too far from the world's origin.
    """
    _check_near("drivable area", np.array(area.bounds).reshape(2, 2))
    distance, grid = compute_signed_distance(area, resolution=resolution)
    matrix = torch.tensor(grid.grid_from_world[:2], dtype=torch.float32)
    return Drivable(torch.tensor(distance), matrix)


def lanes_of(hdmap: HDMap) -> Lanes:
    """The directions of a map's one-way lanes, at places along their middles.

    Raises:
        MapError: the lanes lie too far from the world's origin.
    """
    found = sample_lane_directions(hdmap)
    _check_near("HD map", found[0])
    places, directions, reaches = (torch.tensor(x, dtype=torch.float32) for x in found)
    return Lanes(places, directions, reaches)


def states_of(scene: Scene) -> Float[Tensor, "N T 4"]:
    """x, y, heading and speed of all agents at all steps."""
    return torch.cat([scene.poses, scene.speeds[..., None]], dim=-1)


def step_seconds(scene: Scene) -> float:
    """The usual time between two steps; a second where there is but one."""
    return float(scene.times.diff().median()) if len(scene.times) > 1 else 1.0


def tracks_of(scene: Scene, world: World) -> Tracks:
    """What happens in a scene, back as tracks; agents that are never there are left out."""
    seen = scene.present.any(dim=1).nonzero()[:, 0]
    states = states_of(scene)[seen].double()
    present = scene.present[seen]
    return Tracks(
        times=np.round(scene.times.double().cpu().numpy(), 6),
        states=torch.where(present[..., None], states, torch.nan).cpu().numpy(),
        present=present.cpu().numpy(),
        sizes=scene.sizes[seen].double().cpu().numpy(),
        types=tuple(scene.types[k] for k in seen.tolist()),
        ids=tuple(scene.ids[k] for k in seen.tolist()),
        world=world,
    )


def agent_number(scene: Scene, name: str) -> int:
    """The row of an agent.

    Raises:
        TracksError: there is none of that name.
    """
    if name not in scene.ids:
        some = ", ".join(scene.ids[:8]) + (", ..." if len(scene.ids) > 8 else "")
        raise TracksError(f"there is no agent {name!r} among {len(scene.ids)}: {some}")
    return scene.ids.index(name)


def step_at(scene: Scene, agent: int, time: float | None) -> Int[Tensor, ""]:
    """The step at which an agent is there, nearest to a time in seconds; its first one for None.

    Raises:
        TracksError: it is not there within a second of that time.
    """
    steps = scene.present[agent].nonzero()[:, 0]
    if len(steps) == 0:
        raise TracksError(f"agent {scene.ids[agent]} is never there")
    times = scene.times[steps]
    nearest = 0 if time is None else int((times - time).abs().argmin())
    if time is not None and abs(float(times[nearest]) - time) > 1:
        raise TracksError(
            f"agent {scene.ids[agent]} is there from {float(times[0]):g} to {float(times[-1]):g} s,"
            f" not at {time:g} s"
        )
    return steps[nearest]


def step_at_time(scene: Scene, time: float | None) -> int:
    """The step nearest to a time in seconds; the last one for None.

    Raises:
        ValueError: the time is not within the scene's.
    """
    if time is None:
        return len(scene.times) - 1
    begin, end = float(scene.times[0]), float(scene.times[-1])
    if not begin <= time <= end:
        raise ValueError(f"{time:g} s is not in the scene, from {begin:g} to {end:g} s")
    return int((scene.times - time).abs().argmin())


def check_touches(
    what: str, places: Float[Array, "n 2"], low: Float[Array, "2"], high: Float[Array, "2"]
) -> None:
    """Refuse what is of another place than the map, which lies between two corners.

    Raises:
        TracksError: none of the places is on the map.
    """
    if not ((places > low) & (places < high)).all(axis=1).any():
        raise TracksError(
            f"no {what} touches the map: they lie between {_said(places.min(axis=0))} and "
            f"{_said(places.max(axis=0))} m, the map between {_said(low)} and {_said(high)} m. "
            "Are both of one place?"
        )


def _check_near(what: str, places: Float[Array, "n 2"]) -> None:
    away = np.abs(places).max(initial=0)
    if away > FURTHEST:
        raise MapError(
            f"the {what} lies {away / 1000:,.0f} km from its world's origin, where tensors are "
            f"inexact; at most {FURTHEST / 1000:g} km will do. Give a World whose origin is near, "
            "as geoaim.world.choose_world does"
        )


def _moved(points: Float[Array, "m 2"], before: World, after: World) -> Float[Array, "m 2"]:
    return world_from_crs(after, crs_from_world(before, points), before.crs)


def _said(place: Float[Array, "2"]) -> str:
    return f"({place[0]:.0f}, {place[1]:.0f})"
