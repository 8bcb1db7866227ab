"""Scenery: the objects on plots and pavements of a place."""

from dataclasses import dataclass

from shapely import Geometry, Polygon


@dataclass(frozen=True)
class Building:
    """A building with a rectangular outline, in plan metres and radians."""

    centre: tuple[float, float]
    size: tuple[float, float]  # length and width
    angle: float  # direction of the length, counter-clockwise from +x
    height: float
    flat: bool  # whether the roof is flat, not pitched
    colour: int  # index of the roof's colour


@dataclass(frozen=True)
class Tree:
    """A tree or a shrub: position and crown radius (plan metres), and the seed of its shape."""

    place: tuple[float, float]
    radius: float
    number: int


@dataclass(frozen=True)
class Spot:
    """A parking spot: plan metres, radians, and the share of days on which it is occupied."""

    place: tuple[float, float]
    heading: float
    share: float


@dataclass(frozen=True, eq=False)
class Parcel:
    """A piece of ground (plan metres) with one use."""

    use: str  # "block", "houses", "park", "plaza" or "field"
    area: Polygon


@dataclass(frozen=True, eq=False)
class Scenery:
    """All scenery of a place, on any day; all shapes and positions are in plan metres."""

    parcels: tuple[Parcel, ...]  # the uses of the plots
    verges: Geometry  # grass between kerb and pavement
    slabs: Geometry  # paved yards and squares
    gravel: Geometry  # paths of parcels that are parks
    ponds: Geometry  # water
    soil: Geometry  # bare ground of fields
    buildings: tuple[Building, ...]  # houses and blocks
    trees: tuple[Tree, ...]  # trees, then shrubs
    spots: tuple[Spot, ...]  # places for parked cars
