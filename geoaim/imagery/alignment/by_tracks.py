"""Where imagery truly lies, by tracks alone: what do vehicles drive on, and between what?

Two things speak for a place of the tracks on the imagery. Lane markings and kerbs run along with a
path half a lane beside it, and no edge runs where its wheels' middle does. And vehicles drive on
few kinds of surface: pixels are sorted into kinds by colour and roughness, and a kind counts by how
much more often it lies under tracks than elsewhere, which is learnt from the imagery itself, first
over all places of the prior's range, then over the likely ones.

Both are sums over places along the paths, hence correlations of the imagery with a template drawn
from the tracks, at all shifts at once, for each turn. The score over a temperature is the logarithm
of the likelihood; along a straight road it hardly changes, and the answer says so.
"""

from dataclasses import replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, Int, UInt8
from numpy import ndarray as Array

from geoaim.aim import AIM
from geoaim.errors import AlignmentError
from geoaim.geometry import similarity_about, to_opencv, transform_points
from geoaim.grid import Grid
from geoaim.imagery.alignment.result import LOOSE, PRIOR, Alignment, Prior
from geoaim.imagery.alignment.template_matching import (
    grey_on,
    orientation,
    picture_of,
    smoothed,
)
from geoaim.tracks import Tracks
from geoaim.world import World

RESOLUTION = 0.4  # m a pixel
DRIVEN = ("car", "van", "truck", "bus", "motorcycle")
LEAST_SPEED = 1.0  # m/s: who stands says nothing of directions
CELL = 1.0  # m: places of one cell and direction count once
HALF_LANE = 1.65  # m from a path to the lane's markings
WIDE = 0.45  # m, spread of that
MIDDLE = 0.55  # m, spread of where no edges are
BODY = 1.0  # m to each side of a path that is driven over
SIDE = 6.0  # m to each side that a template reaches
KINDS = 16  # of surfaces
WEIGHTS = (0.5, 2.0, 2.0, 12.0)  # of lightness, both of colour, and roughness in kinds
RARE = 0.003  # share added to each kind's, so that none is impossible
TEMPERATURE = 120.0
TOLD = 0.6  # of the spread before imagery is seen that may be left of it
FLOOR = 0.2  # m of standard deviation: vehicles' boxes and paint are no better known
TURN_STEP = 1.0  # m between turns, at the ends of the tracks
FEWEST = 100  # places
LEAST_KNOWN = 0.05  # of the ground around the tracks


def align_tracks(imagery: AIM, tracks: Tracks, *, prior: Prior = PRIOR) -> Alignment:
    """Find how imagery has to be moved to lie under the tracks of vehicles.

    Args:
        imagery: where it says to lie.
        tracks: in the same world; of people nothing is used.
        prior: how far off the imagery may be; its size is taken as right.

    Raises:
        AlignmentError: too few places are driven over, or the imagery does not tell where.
        ValueError: they lie in different worlds.
    """
    if imagery.world != tracks.world:
        raise ValueError(f"the imagery lies in {imagery.world}, the tracks in {tracks.world}")
    reach = prior.reach
    paths = driven_places(tracks)
    if len(paths) < FEWEST:
        raise AlignmentError(
            f"moving vehicles pass {len(paths)} places of a metre; {FEWEST} or more are needed to "
            "lay imagery under tracks. Give more tracks, control points, or an AIM"
        )
    middle = (paths[:, :2].min(axis=0) + paths[:, :2].max(axis=0)) / 2
    half = float(np.abs(paths[:, :2] - middle).max())
    grid = _grid(tracks.world, middle, half * np.sqrt(2) + 2 * SIDE + reach)
    edges, kinds = _edges_and_kinds(imagery, grid)
    count = int(np.ceil(prior.turn * half / TURN_STEP))
    turns = np.arange(-count, count + 1) * TURN_STEP / half
    steps = round(reach / RESOLUTION)
    likely = np.full((2 * steps + 1,) * 2, (2 * steps + 1.0) ** -2)
    middling = _template(paths, grid)
    for some in (turns[count % 3 :: 3], turns):  # a third do to learn surfaces
        picture = np.dstack([edges, _worth(kinds, likely, middling)])
        templates = (_template(_turned(paths, middle, angle), grid) for angle in some)
        scores = np.stack([_scores(picture, template, steps) for template in templates])
        posterior = _posterior(scores, reach)
        likely = posterior.sum(axis=0)
    _refuse(posterior.sum(axis=0), len(paths), reach)
    return _judged(posterior, turns, middle, len(paths))


def driven_places(tracks: Tracks) -> Float[Array, "M 3"]:
    """x, y and heading of moving vehicles, one for each cell and direction."""
    wheels = np.array([kind in DRIVEN for kind in tracks.types])
    moving = tracks.present & wheels[:, None]
    moving[moving] = np.abs(tracks.states[moving][:, 3]) > LEAST_SPEED
    states = tracks.states[moving][:, :3]
    cells = np.floor(states / [CELL, CELL, np.pi / 8])
    return states[np.unique(cells, axis=0, return_index=True)[1]]


class Template(NamedTuple):
    """What paths look for in a picture of edges and worths, and its corner on the grid."""

    picture: Float32[Array, "h w 4"]
    top: int
    left: int


def _grid(world: World, middle: Float[Array, "2"], reach: float) -> Grid:
    side = int(np.ceil(2 * reach / RESOLUTION))
    left, top = middle[0] - reach, middle[1] + reach
    matrix = np.array([[RESOLUTION, 0, left], [0, -RESOLUTION, top], [0, 0, 1.0]])
    return Grid((side, side), matrix, world)


def _edges_and_kinds(imagery: AIM, grid: Grid) -> tuple[Float32[Array, "H W 3"], Int[Array, "H W"]]:
    """Directions and strength of edges, and the kind of surface of each pixel; -1: unknown."""
    known = imagery.coverage * ~_blank(imagery.image)
    picture = picture_of(replace(imagery, coverage=known), grid.resolution)
    grey, there = grey_on(picture, np.eye(3), grid)
    if there.mean() < LEAST_KNOWN:
        raise AlignmentError(
            f"the imagery shows hardly anything where the tracks are: {there.mean():.1%} of the "
            "ground around them. Is it the same place, and the right CRS?"
        )
    edges = orientation(grey, there, grid.resolution)
    strength = np.hypot(edges[..., 0], edges[..., 1])
    flags = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP
    colours = smoothed(imagery.image, grid.resolution / imagery.resolution)
    image_from_grid = np.linalg.inv(imagery.world_from_image) @ grid.world_from_grid
    image = cv2.warpPerspective(colours, to_opencv(image_from_grid), grid.shape[::-1], flags=flags)
    return np.dstack([edges, strength]), _kinds(image, grey, there)


def _blank(image: UInt8[Array, "H W 3"]) -> Bool[Array, "H W"]:
    """Where a file has nothing and does not say so: patches of pure white or black."""
    whole = np.ones((5, 5), np.uint8)
    blank = np.zeros(image.shape[:2], bool)
    for level in (0, 255):
        flat = (image == level).all(axis=-1).astype(np.uint8)
        blank |= cv2.dilate(cv2.morphologyEx(flat, cv2.MORPH_OPEN, whole), whole) > 0
    return blank


def _kinds(
    image: UInt8[Array, "H W 3"], grey: Float32[Array, "H W"], known: Bool[Array, "H W"]
) -> Int[Array, "H W"]:
    """Pixels sorted into `KINDS` by lightness, colour and roughness."""
    lab = cv2.cvtColor(cv2.GaussianBlur(image, (0, 0), 0.35 / RESOLUTION), cv2.COLOR_RGB2LAB)
    rough = cv2.blur(grey * grey, (9, 9)) - cv2.blur(grey, (9, 9)) ** 2
    rough = np.log1p(np.sqrt(np.maximum(rough, 0)))
    features = np.dstack([lab, rough]).astype(np.float32) * np.array(WEIGHTS, np.float32)
    given = features[known]
    some = given[:: max(len(given) // 20_000, 1)]
    ranks = np.argsort(np.argsort(some @ np.ones(4, np.float32), kind="stable"), kind="stable")
    labels = (ranks * KINDS // len(some)).astype(np.int32)  # a start without chance
    stop = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 30, 0.1)
    _, _, centres = cv2.kmeans(some, KINDS, labels, stop, 1, cv2.KMEANS_USE_INITIAL_LABELS)
    distance = [((features - centre) ** 2).sum(axis=-1) for centre in centres]
    return np.where(known, np.argmin(distance, axis=0), -1)


def _turned(
    paths: Float[Array, "M 3"], middle: Float[Array, "2"], angle: float
) -> Float[Array, "M 3"]:
    places = transform_points(similarity_about(middle, angle, 1.0), paths[:, :2])
    return np.column_stack([places, paths[:, 2] + angle])


def _template(paths: Float[Array, "M 3"], grid: Grid) -> Template:
    """Edges wanted along both sides of each path and none in its middle, and what it covers."""
    sides = np.arange(-SIDE, SIDE + 0.01, grid.resolution)
    x, y, heading = paths.T[:, :, None]
    places = np.stack([x - sides * np.sin(heading), y + sides * np.cos(heading)], axis=-1)
    pixels = transform_points(np.linalg.inv(grid.world_from_grid), places.reshape(-1, 2))
    left, top = (int(n) - 1 for n in np.floor(pixels.min(axis=0)))
    right, bottom = (int(n) + 1 for n in np.ceil(pixels.max(axis=0)))
    beside = np.exp(-(((np.abs(sides) - HALF_LANE) / WIDE) ** 2) / 2)
    doubled = -2 * heading - np.pi  # of an edge along the path, v down
    wanted = np.stack(
        [
            np.cos(doubled) * beside,
            np.sin(doubled) * beside,
            np.broadcast_to(-np.exp(-((sides / MIDDLE) ** 2) / 2), (len(paths), len(sides))),
            np.broadcast_to(np.abs(sides) <= BODY, (len(paths), len(sides))),
        ],
        axis=-1,
    )
    picture = _splat(pixels - (left, top), wanted.reshape(-1, 4), (bottom - top, right - left))
    return Template(picture, top, left)


def _splat(
    pixels: Float[Array, "n 2"], values: Float[Array, "n c"], size: tuple[int, int]
) -> Float32[Array, "h w c"]:
    """Sums of values at places, each shared by the four pixels around it."""
    corner = np.floor(pixels - 0.5).astype(int)
    right, down = (pixels - 0.5 - corner).T
    total = np.zeros((size[0] * size[1], values.shape[1]))
    for row, column, share in (
        (0, 0, (1 - down) * (1 - right)),
        (0, 1, (1 - down) * right),
        (1, 0, down * (1 - right)),
        (1, 1, down * right),
    ):
        flat = (corner[:, 1] + row) * size[1] + corner[:, 0] + column
        for channel, value in enumerate(values.T):
            total[:, channel] += np.bincount(flat, share * value, len(total))
    return total.reshape(*size, -1).astype(np.float32)


def _worth(
    kinds: Int[Array, "H W"], likely: Float[Array, "n n"], template: Template
) -> Float32[Array, "H W"]:
    """By how much more often a pixel's kind is driven over than seen, as a logarithm.

    0 is what is driven over on average, and what is unknown.
    """
    height, width = template.picture.shape[:2]
    driven = template.picture[..., 3]
    near = np.s_[template.top : template.top + height, template.left : template.left + width]
    seen, under = np.empty(KINDS), np.empty(KINDS)
    for kind in range(KINDS):
        there = (kinds == kind).astype(np.float32)
        seen[kind] = there.mean()
        under[kind] = (cv2.filter2D(there, -1, likely)[near] * driven).sum()
    seen, under = seen / seen.sum(), under / under.sum()
    ratio = np.log((under + RARE) / (seen + RARE))
    found = (ratio - (under * ratio).sum())[np.maximum(kinds, 0)]
    return np.where(kinds >= 0, found, 0).astype(np.float32)


def _scores(
    picture: Float32[Array, "H W 4"], template: Template, steps: int
) -> Float32[Array, "n n"]:
    """Sums of the template times the picture, at all shifts."""
    (height, width), top, left = template.picture.shape[:2], template.top, template.left
    region = picture[top - steps : top + height + steps, left - steps : left + width + steps]
    return cv2.matchTemplate(region, template.picture, cv2.TM_CCORR)


def _posterior(scores: Float32[Array, "t n n"], reach: float) -> Float[Array, "t n n"]:
    """Probabilities of turns and shifts; before the imagery is seen, small shifts are likelier."""
    steps = scores.shape[1] // 2
    shift = np.arange(-steps, steps + 1) * RESOLUTION
    prior = -((shift**2)[:, None] + shift**2) / 2 / (reach / 2) ** 2
    logarithm = (scores - scores.max()) / TEMPERATURE + prior
    found = np.exp(logarithm - logarithm.max())
    return found / found.sum()


def _refuse(weight: Float[Array, "n n"], places: int, reach: float) -> None:
    """Refuse what the imagery does not tell, and what leans on the end of the range."""
    shift, covariance = _moments(weight)
    variances, axes = np.linalg.eigh(covariance)
    best, worst = np.sqrt(variances)
    if best > min(LOOSE, TOLD * reach / 2):
        raise AlignmentError(
            f"the tracks pass {places} places, and do not tell where the imagery lies: to "
            f"{best:.1f} m at best, {worst:.1f} m at worst (one sigma). Is it the same place? Give "
            "more tracks, a smaller range, control points, or an AIM"
        )
    for spread, axis in zip((best, worst), axes.T, strict=True):
        if spread <= LOOSE and abs(shift @ axis) > reach - 2 * spread:
            raise AlignmentError(
                f"the best place is {np.linalg.norm(shift):.1f} m off, at the end of the "
                f"{reach:g} m that were searched. Name a wider range"
            )


def _judged(
    posterior: Float[Array, "t n n"],
    turns: Float[Array, "t"],
    middle: Float[Array, "2"],
    places: int,
) -> Alignment:
    """The mean of the probable places, without a turn when that is within its error."""
    share = posterior.sum(axis=(1, 2))
    turn = float((share * turns).sum())
    spread = float(np.sqrt((share * (turns - turn) ** 2).sum()))
    straight = abs(turn) <= 2 * spread
    mean, whole = _moments(posterior.sum(axis=0))
    shift = _moments(posterior[len(turns) // 2])[0] if straight else mean
    stated_from_true = similarity_about(middle, 0.0 if straight else turn, 1.0)
    stated_from_true[:2, 2] += shift
    return Alignment(
        true_from_stated=np.linalg.inv(stated_from_true),
        model="translation" if straight else "rigid",
        covariance=whole,
        middle=middle,
        evidence={"places": places, "turn_sigma_degrees": float(np.degrees(spread))},
    )


def _moments(weight: Float[Array, "n n"]) -> tuple[Float[Array, "2"], Float[Array, "2 2"]]:
    """Mean and covariance of the shift, metres east and north."""
    steps = len(weight) // 2
    weight = weight / weight.sum()
    along = np.arange(-steps, steps + 1) * RESOLUTION
    places = np.stack(np.meshgrid(along, -along), axis=-1)
    shift = np.einsum("ij,ijk->k", weight, places)
    apart = places - shift
    covariance = np.einsum("ij,ijk,ijl->kl", weight, apart, apart)
    return shift, covariance + np.eye(2) * FLOOR**2
