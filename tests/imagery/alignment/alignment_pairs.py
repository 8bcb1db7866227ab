"""A made place, seen by the drone and by another sensor on another day, and its traffic."""

from dataclasses import replace
from functools import cache

from benchmarks.synthetic import draw_place, make_place, make_sample, tracks_of, world_from_image
from benchmarks.synthetic.imagery import make_other_day, photograph
from geoaim.aim.aim import AIM
from geoaim.base.geometry import make_similarity
from geoaim.base.world import World

GROUND, PHOTO = 0.2, 0.5  # m a pixel


def as_aim(image, world_from_image, world=None):
    return AIM.from_image(
        image, world_from_image, World(None) if world is None else world, "a test"
    )


@cache
def made(seed=2, kind="junction"):
    """The AIM, another day's picture of it where it truly lies, and tracks."""
    place = make_place(seed, kind=kind)
    tracks = tracks_of(make_sample(seed, kind=kind, minutes=0.5, video=None))
    day = make_other_day(place)
    photo = photograph(place, day, tracks, sensor_resolution=PHOTO, resolution=0.2)
    return (
        as_aim(draw_place(place, resolution=GROUND), world_from_image(place, GROUND), place.world),
        as_aim(photo, world_from_image(place, PHOTO), place.world),
        tracks,
    )


def misplaced(picture, *, shift=(0.0, 0.0), turn=0.0, zoom=1.0):
    """The picture misplaced about its middle, and stated_from_true."""
    matrix = make_similarity(picture.corners.mean(axis=0), turn, zoom)
    matrix[:2, 2] += shift
    return replace(picture, world_from_image=matrix @ picture.world_from_image), matrix
