"""A scene: a map, its agents and its lights as tensors, made of an AIM, tracks and lights."""

from collections import Counter
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from numpy import ndarray as Array
from torch import Tensor

from geoaim.aim.aim import AIM
from geoaim.base.displays import Display
from geoaim.base.errors import MapError, TracksError, warn
from geoaim.base.grid import Grid
from geoaim.base.world import World, change_world
from geoaim.rendering.corners import make_ground_from_aim
from geoaim.rendering.ground import Ground
from geoaim.tracks.agent_types import get_colour
from geoaim.tracks.changes import to_world
from geoaim.tracks.lights import STOP_LINE_COLOUR, UNKNOWN, Lights, find_light_states
from geoaim.tracks.tracks import Tracks, count_agents, describe_times

if TYPE_CHECKING:
    from matplotlib.axes import Axes

# largest distance from the world's origin; float32 still resolves millimetres there
MAX_ORIGIN_DISTANCE_M = 10_000.0
# largest difference between a wanted time and the nearest one at which an agent is present
MAX_TIME_OFFSET_S = 1.0
MIN_SHARE_ON_MAP = 0.5  # a scene warns when a smaller share of the agents' positions is on the map
MAX_LISTED_AGENTS = 8


@dataclass(frozen=True, eq=False, repr=False)
class Scene(Display):
    """A map, and the agents and lights on it (N agents, T steps, L lights).

    Attributes:
        ground: the map.
        times: (T,) seconds.
        poses: (N, T, 3) x, y, heading in the map's world; NaN while absent.
        speeds: (N, T) m/s, negative in reverse; NaN while absent.
        present: (N, T) whether the agent is present.
        sizes: (N, 2) length and width, metres.
        types: agent types, as in `geoaim.tracks.agent_types`.
        ids: a name for each agent.
        stop_lines: (L, 2, 2) both ends of the stop line of each light, metres.
        light_states: (T, L) as in `geoaim.tracks.lights`.
        observed: (N, T, 4) x, y, heading, speed as they are known at each time, from the rows of
            the tracks until then; NaN while absent or not yet seen for long enough. Predictions
            start from these.
        world: the plane of the metres; None: not known.
        observed_sigma: (N, T) standard deviations of the observed speeds, m/s. None: not stated.
        smoothed: whether poses and speeds are smoothed estimates of noisy detections, as those of
            `track_video` are; models learn from these.
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
    observed: Float[Tensor, "N T 4"]
    world: World | None = None
    smoothed: bool = False
    observed_sigma: Float[Tensor, "N T"] | None = None

    @property
    def states(self) -> Float[Tensor, "N T 4"]:
        """x, y (metres), heading (radians) and speed (m/s) of all agents."""
        return torch.cat([self.poses, self.speeds[..., None]], dim=-1)

    @property
    def dt(self) -> float:
        """Median time between two steps, seconds; 1 in a scene of one step."""
        return float(self.times.diff().median()) if len(self.times) > 1 else 1.0

    def to(
        self, device: torch.device | str | None = None, dtype: torch.dtype | None = None
    ) -> "Scene":
        """Move the tensors to a device, or convert places, speeds and sizes to a dtype."""
        return replace(
            self,
            ground=self.ground.to(device, dtype),
            times=self.times.to(device=device),
            poses=self.poses.to(device=device, dtype=dtype),
            speeds=self.speeds.to(device=device, dtype=dtype),
            present=self.present.to(device=device),
            sizes=self.sizes.to(device=device, dtype=dtype),
            stop_lines=self.stop_lines.to(device=device, dtype=dtype),
            light_states=self.light_states.to(device=device),
            observed=self.observed.to(device=device, dtype=dtype),
            observed_sigma=None
            if self.observed_sigma is None
            else self.observed_sigma.to(device=device, dtype=dtype),
        )

    def summarize(self) -> dict[str, str]:
        """Summarize the agents by type, the times, the lights and the size of the map."""
        low, high = self.ground.bounds[0]
        return {
            "agents": count_agents(self.types),
            "time": describe_times(self.times.double().cpu().numpy()),
            "stop lines of lights": str(len(self.stop_lines)),
            "map": "{:.0f} x {:.0f} m".format(*(high - low).tolist()),
        }

    def _draw(self, axes: "Axes") -> None:
        from geoaim.base.map_axes import draw_lines, move_to_axes

        self.draw_ground(axes)
        points = self.poses[..., :2].cpu().numpy()
        for kind, count in Counter(self.types).most_common():
            rows = [row for row, other in enumerate(self.types) if other == kind]
            lines = [move_to_axes(axes, line, self.world) for line in points[rows]]
            draw_lines(axes, lines, get_colour(kind), label=f"{count} {kind}")
        if len(self.stop_lines):
            stops = move_to_axes(axes, self.stop_lines.cpu().numpy(), self.world)
            draw_lines(axes, stops, STOP_LINE_COLOUR, width=2.5, label="stop lines of lights")

    def draw_ground(self, axes: "Axes", bounds: Float[Array, "2 2"] | None = None) -> None:
        """Draw the map alone, or its part in bounds (metres in the scene's world)."""
        from geoaim.base.map_axes import draw_image, move_to_axes

        if bounds is not None:
            bounds = move_to_axes(axes, bounds, self.world)
        image = (self.ground.image[:3] * 255).round().byte().permute(1, 2, 0).cpu().numpy()
        image_from_world = np.vstack([self.ground.image_from_world[0].double().cpu(), [0, 0, 1.0]])
        grid = Grid(image.shape[:2], np.linalg.inv(image_from_world), self.world)
        draw_image(axes, image, grid, self.ground.coverage[0].cpu().numpy() > 0, bounds)


def slice_scene(scene: Scene, steps: slice) -> Scene:
    """Cut some steps out of a scene; its agents stay, even those that are absent then."""
    return replace(
        scene,
        times=scene.times[steps],
        poses=scene.poses[:, steps],
        speeds=scene.speeds[:, steps],
        present=scene.present[:, steps],
        light_states=scene.light_states[steps],
        observed=scene.observed[:, steps],
        observed_sigma=None if scene.observed_sigma is None else scene.observed_sigma[:, steps],
    )


def make_scene(aim: AIM, tracks: Tracks, lights: Lights | None = None) -> Scene:
    """Bring a map, tracks and lights into the map's world, as tensors.

    Map, tracks and lights must all have a CRS, which may differ, or all lie in a local plane.

    Args:
        aim: the map, at most 10 km (`MAX_ORIGIN_DISTANCE_M`) from its world's origin; one whose
            matrix is not affine is resampled north up.
        tracks: the tracks of the agents.
        lights: None for a scene without traffic lights.

    Returns:
        The scene at the tracks' times, on the CPU. Its map is grey where the AIM has no coverage.

    Raises:
        TracksError: only some of the three are georeferenced, no track or no stop line touches the
            map, or the lights' states begin after the tracks end.
        MapError: the map lies further from its world's origin.
    """
    tracks = to_world(tracks, aim.world)
    poses = tracks.states[..., :3]
    check_near_origin("map", aim.corners)
    if not tracks.present.any():
        raise TracksError("no agent is present in the tracks at any time")
    bounds = np.stack([aim.corners.min(axis=0), aim.corners.max(axis=0)])
    places = poses[tracks.present][:, :2]
    check_touches_map("track", places, bounds)
    share = float(((places > bounds[0]) & (places < bounds[1])).all(axis=1).mean())
    if share < MIN_SHARE_ON_MAP:
        warn(
            f"only {share:.0%} of the agents' positions lie on the map. Do both have the same "
            "origin? Tracks in pixels have theirs at the top-left corner of the image"
        )
    sigma = tracks.observed_sigma
    lines, states = np.empty((0, 2, 2)), np.empty((len(tracks.times), 0), np.int8)
    if lights is not None:
        lines = transform_stop_lines(lights, aim.world)
        check_touches_map("stop line", lines.reshape(-1, 2), bounds)
        states = _sample_light_states(lights, tracks)
    return Scene(
        ground=make_ground_from_aim(aim),
        times=torch.tensor(tracks.times),
        poses=torch.tensor(poses, dtype=torch.float32),
        speeds=torch.tensor(tracks.states[..., 3], dtype=torch.float32),
        present=torch.tensor(tracks.present),
        sizes=torch.tensor(tracks.sizes, dtype=torch.float32),
        types=tracks.types,
        ids=tracks.ids,
        stop_lines=torch.tensor(lines, dtype=torch.float32),
        light_states=torch.tensor(states),
        observed=torch.tensor(tracks.get_observed(), dtype=torch.float32),
        world=aim.world,
        smoothed=tracks.uncertainty is not None,
        observed_sigma=None if sigma is None else torch.tensor(sigma, dtype=torch.float32),
    )


def make_tracks(scene: Scene, world: World | None = None) -> Tracks:
    """Make tracks of a scene's agents that are ever present, with times rounded to the microsecond.

    Raises:
        ValueError: the scene lies in another world.
    """
    if world is not None and scene.world not in (None, world):
        raise ValueError(f"the scene lies in {scene.world}, and was said to lie in {world}")
    world = world or scene.world or World(None)
    agents = scene.present.any(dim=1).nonzero()[:, 0]
    states = scene.states[agents].double()
    present = scene.present[agents]
    return Tracks(
        times=np.round(scene.times.double().cpu().numpy(), 6),
        states=torch.where(present[..., None], states, torch.nan).cpu().numpy(),
        present=present.cpu().numpy(),
        sizes=scene.sizes[agents].double().cpu().numpy(),
        types=tuple(scene.types[k] for k in agents.tolist()),
        ids=tuple(scene.ids[k] for k in agents.tolist()),
        world=world,
    )


def find_agent(scene: Scene, name: str) -> int:
    """Find the row of the agent whose id is `name`.

    Raises:
        TracksError: no agent has that id.
    """
    if name not in scene.ids:
        more = ", ..." if len(scene.ids) > MAX_LISTED_AGENTS else ""
        some = ", ".join(scene.ids[:MAX_LISTED_AGENTS]) + more
        raise TracksError(f"there is no agent {name!r} among {len(scene.ids)}: {some}")
    return scene.ids.index(name)


def find_agent_step(scene: Scene, agent: int, time: float | None) -> Int[Tensor, ""]:
    """Find the step nearest to a time (s; None: its first) at which an agent is present.

    Raises:
        TracksError: the agent is not present within `MAX_TIME_OFFSET_S` of that time.
    """
    steps = scene.present[agent].nonzero()[:, 0]
    if len(steps) == 0:
        raise TracksError(f"agent {scene.ids[agent]} is never present")
    times = scene.times[steps]
    nearest = 0 if time is None else int((times - time).abs().argmin())
    if time is not None and abs(float(times[nearest]) - time) > MAX_TIME_OFFSET_S:
        raise TracksError(
            f"agent {scene.ids[agent]} is present from {float(times[0]):g} to "
            f"{float(times[-1]):g} s, not at {time:g} s"
        )
    return steps[nearest]


def find_step(scene: Scene, time: float | None) -> int:
    """Find the index of the step nearest to a time in seconds; of the last one for None.

    Raises:
        ValueError: the time is not within the scene's.
    """
    if time is None:
        return len(scene.times) - 1
    begin, end = float(scene.times[0]), float(scene.times[-1])
    if not begin <= time <= end:
        raise ValueError(f"{time:g} s is not in the scene, from {begin:g} to {end:g} s")
    return int((scene.times - time).abs().argmin())


def check_touches_map(name: str, points: Float[Array, "n 2"], bounds: Float[Array, "2 2"]) -> None:
    """Check that data, such as a "track", are of the same place as the map: low and high x and y.

    Raises:
        TracksError: no point lies within the bounds.
    """
    low, high = bounds
    if not ((points > low) & (points < high)).all(axis=1).any():
        ends = points.min(axis=0), points.max(axis=0), low, high
        first, last, left, right = (f"({x:.0f}, {y:.0f})" for x, y in ends)
        raise TracksError(
            f"no {name} touches the map: they lie between {first} and {last} m, the map between "
            f"{left} and {right} m. Do both show the same place?"
        )


def check_near_origin(name: str, points: Float[Array, "n 2"]) -> None:
    """Check that data lie near enough to their world's origin for tensors of float32.

    Raises:
        MapError: a coordinate is beyond `MAX_ORIGIN_DISTANCE_M`; the message calls the data `name`.
    """
    distance = np.abs(points).max(initial=0)
    if distance > MAX_ORIGIN_DISTANCE_M:
        raise MapError(
            f"the {name} lies {distance / 1000:,.0f} km from its world's origin, where tensors are "
            f"inexact; at most {MAX_ORIGIN_DISTANCE_M / 1000:g} km are allowed. Give a World whose "
            "origin is near, as geoaim.base.world.choose_world does"
        )


def transform_stop_lines(lights: Lights, world: World) -> Float[Array, "L 2 2"]:
    """Transform stop lines (both ends of each) to metres of a world.

    Raises:
        TracksError: only one of the two worlds is georeferenced.
    """
    if (lights.world.crs is None) != (world.crs is None):
        raise TracksError(
            f"the map lies in {world.crs or 'a local plane'} and the lights in "
            f"{lights.world.crs or 'a local plane'}; georeference both"
        )
    return change_world(lights.world, world, lights.lines.reshape(-1, 2)).reshape(-1, 2, 2)


def _sample_light_states(lights: Lights, tracks: Tracks) -> Int[Array, "T L"]:
    """Look up the states of lights at the times of tracks."""
    states = find_light_states(lights, tracks.times)
    if (states == UNKNOWN).all():
        raise TracksError(
            f"the lights' states begin at {lights.times[0]:g} s, the tracks end at "
            f"{tracks.times[-1]:g} s. Are both from the same recording?"
        )
    return states
