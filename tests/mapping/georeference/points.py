"""Control points on a grid, with known true transforms."""

import numpy as np

from geoaim.base.geometry import transform_points
from geoaim.base.world import World, lonlat_from_world
from geoaim.mapping.georeference.control_points import ControlPoints

HEIGHT, WIDTH = 1080, 1920
SIZE = {"height": HEIGHT, "width": WIDTH}
GRID = np.stack(np.meshgrid([150.0, 700, 1250, 1800], [120.0, 520, 950]), -1).reshape(-1, 2)
TURN = 0.05 * np.array([[np.cos(0.5), np.sin(0.5)], [np.sin(0.5), -np.cos(0.5)]])
TRUTH = np.block([[TURN, np.array([[30.0], [-20.0]])], [np.zeros((1, 2)), np.ones((1, 1))]])
TILTED = TRUTH @ np.array([[1.0, 0, 0], [0, 1, 0], [6e-5, -3e-5, 1]])
UTM = World("EPSG:32635", (536800.0, 5972500.0))


def make_points(truth=TRUTH, pixels=GRID, noise=0.0, crs=None, seed=0):
    generator = np.random.default_rng(seed)
    coordinates = transform_points(truth, pixels)
    if crs == "EPSG:32635":
        coordinates = coordinates + UTM.origin
    elif crs == "EPSG:4326":
        coordinates = lonlat_from_world(UTM, coordinates)
    picked = pixels + noise * generator.normal(size=pixels.shape)
    count = len(pixels)
    names = tuple(f"gcp{i}" for i in range(count))
    return ControlPoints(picked, coordinates, crs, names, (None,) * count)
