"""Scenery: the objects on plots and pavements of a place."""

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, Polygon


@dataclass(frozen=True)
class Building:
    """A building: a rectangle (length and width along its angle, metres) and its height."""

    centre: tuple[float, float]
    size: tuple[float, float]
    angle: float
    height: float
    flat: bool
    colour: int


@dataclass(frozen=True)
class Tree:
    """A tree or a shrub: position and crown radius (metres), and the seed of its shape."""

    place: tuple[float, float]
    radius: float
    number: int


@dataclass(frozen=True)
class Spot:
    """A parking spot: position, heading, and the share of days on which it is occupied."""

    place: tuple[float, float]
    heading: float
    share: float


@dataclass(frozen=True, eq=False)
class Parcel:
    """A piece of ground with one use, one of `USES`."""

    use: str
    area: Polygon


@dataclass(frozen=True, eq=False)
class Scenery:
    """All scenery of a place, on any day."""

    parcels: tuple[Parcel, ...]  # the uses of the plots
    verges: Geometry  # grass between kerb and pavement
    slabs: Geometry  # paved yards and squares
    gravel: Geometry  # paths of parcels that are parks
    ponds: Geometry  # water
    soil: Geometry  # bare ground of fields
    buildings: tuple[Building, ...]  # houses and blocks
    trees: tuple[Tree, ...]  # trees, then shrubs
    hedges: tuple[Float[Array, "4 2"], ...]  # polygons
    lamps: Float[Array, "L 2 2"]  # foot and tip of each, and of the masts of the signals
    spots: tuple[Spot, ...]  # for parked cars
    spare: tuple[Float[Array, "4 2"], ...]  # rectangles where a container may stand on another day
