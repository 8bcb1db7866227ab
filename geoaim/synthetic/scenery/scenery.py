"""Scenery: what is on the plots and pavements of a place, on any day."""

from dataclasses import dataclass

from jaxtyping import Float
from numpy import ndarray as Array
from shapely import Geometry, Polygon


@dataclass(frozen=True)
class Building:
    """A house: a rectangle (metres along and across its angle) of some height."""

    centre: tuple[float, float]
    size: tuple[float, float]
    angle: float
    height: float
    flat: bool
    colour: int


@dataclass(frozen=True)
class Tree:
    """A tree or a shrub: its place, the radius of its crown, and a number that draws it."""

    place: tuple[float, float]
    radius: float
    number: int


@dataclass(frozen=True)
class Spot:
    """Where a car may be parked: its place and heading; `share` of the days one is there."""

    place: tuple[float, float]
    heading: float
    share: float


@dataclass(frozen=True, eq=False)
class Parcel:
    """A piece of ground that is used for one thing: one of `USES`."""

    use: str
    area: Polygon


@dataclass(frozen=True, eq=False)
class Scenery:
    """What is on the plots and pavements of a place, on any day.

    Attributes:
        parcels: what the plots are used for.
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
        spare: rectangles where something may stand on another day.
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
