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
    """All scenery of a place, on any day.

    Attributes:
        parcels: the uses of the plots.
        verges: grass between kerb and pavement.
        slabs: paved yards and squares.
        gravel: paths of parcels that are parks.
        ponds: water.
        soil: bare ground of fields.
        buildings: houses and blocks.
        trees: trees, then shrubs.
        hedges: polygons.
        lamps: foot and tip of each, and of the masts of the signals.
        spots: for parked cars.
        spare: rectangles where a container may stand on another day.
    """

    parcels: tuple[Parcel, ...]
    verges: Geometry
    slabs: Geometry
    gravel: Geometry
    ponds: Geometry
    soil: Geometry
    buildings: tuple[Building, ...]
    trees: tuple[Tree, ...]
    hedges: tuple[Float[Array, "4 2"], ...]
    lamps: Float[Array, "L 2 2"]
    spots: tuple[Spot, ...]
    spare: tuple[Float[Array, "4 2"], ...]
