"""Georeferences from simulated control points: errors, stated regions and rivals.

    python -m geoaim.bench.georeference --trials 60 --json docs/bench/georeference.json \
        --chart docs/images/georeference.png

Two simulators that share no code alternate: the nine terms of the method's own model,
and a pinhole camera with tilt, pixel aspect and two lens terms (OpenCV). Points are spread,
one-sided or clustered. Their noise, 0.5 to 5 px, is not told to the method. Settings were chosen on
seed 1; seed 2 is published.
"""

import warnings
from collections.abc import Callable
from typing import Annotated, Any

import cv2
import numpy as np
import typer
from jaxtyping import Float
from matplotlib.figure import Figure
from numpy import ndarray as Array
from rasterio.control import GroundControlPoint
from rasterio.transform import GCPTransformer

from geoaim.bench.report import ChartFile, JsonFile, Row, print_rows, write_json
from geoaim.errors import GeoaimWarning, GeoreferenceError
from geoaim.files import write_figure
from geoaim.geometry import image_corners, make_similarity, transform_points
from geoaim.mapping.georeference.control_points import ControlPoints
from geoaim.mapping.georeference.estimate import estimate_georeference
from geoaim.mapping.georeference.georeference import world_from_pixels
from geoaim.mapping.georeference.normalised_plane import Points, half_diagonal, undistort_points
from geoaim.mapping.georeference.posterior import PRIOR_SIGMA, ellipse_factor
from geoaim.mapping.georeference.transform_models import compose_world_from_image
from geoaim.mapping.georeference.uncertainty import predict_uncertainty

HEIGHT, WIDTH = 1080, 1920
LAYOUTS = (  # boxes of the points, shares of the sides: left, top, right, bottom
    (0.06, 0.06, 0.94, 0.94),
    (0.06, 0.06, 0.35, 0.94),
    (0.42, 0.35, 0.67, 0.65),
)
NOISE_PX = (0.5, 5.0)
NOISES = ("normal", "heavy tails", "one wrong")
HEAVY_DOF = 3  # of Student's t
WRONG_PX = (10.0, 1000.0)  # error of the wrong point
POINT_COUNTS = (4, 5, 6, 8, 12)
RIVALS = ("plain homography", "GDAL polynomial", "GDAL thin plate")
# a normal error in the plane is within ellipse_factor(inf) deviations in 95 %, sqrt(2 ln 2) in 50 %
EXACT_RATIO = ellipse_factor(np.inf) / np.sqrt(2.0 * np.log(2.0))
Ground = tuple[Callable[[Points], Points], float]  # ground from pixels, and metres per pixel


def draw_terms_camera(generator: np.random.Generator) -> Ground:
    """Draw a camera of the method's own nine terms, up to three times the expected sizes."""
    terms = np.zeros(9)
    terms[4:] = generator.choice([0.0, 1.0, 3.0]) * PRIOR_SIGMA * generator.normal(size=5)
    unit = 0.05 * half_diagonal(HEIGHT, WIDTH)
    plane = make_similarity(np.zeros(2), generator.uniform(0.0, 2.0 * np.pi), unit)
    matrix = compose_world_from_image(plane, terms, (HEIGHT, WIDTH))

    def transform(pixels: Points) -> Points:
        return transform_points(matrix, undistort_points(pixels, float(terms[8]), HEIGHT, WIDTH))

    return transform, 0.05


def draw_pinhole_camera(generator: np.random.Generator) -> Ground:
    """Draw a pinhole camera with tilt (3 degrees, every fifth up to 20), lens and pixel aspect."""
    focal = WIDTH / 2.0 / np.tan(np.radians(generator.uniform(25.0, 42.0)))
    tilt = np.radians(abs(generator.normal()) * 3.0)
    if generator.random() < 0.2:
        tilt = np.radians(generator.uniform(5.0, 20.0))
    lens = np.array([*generator.normal(size=2) * [0.01, 0.003], 0.0, 0.0])
    aspect = 1.0 + 0.005 * generator.normal()
    matrix = np.array([[focal, 0, WIDTH / 2], [0, focal * aspect, HEIGHT / 2], [0, 0, 1.0]])
    azimuth, yaw = generator.uniform(0.0, 2.0 * np.pi, 2)
    axis = tilt * np.array([np.cos(azimuth), np.sin(azimuth), 0.0])
    turned = cv2.Rodrigues(np.array([0.0, 0.0, yaw]))[0] @ np.diag([1.0, -1.0, -1.0])
    rotation = turned @ cv2.Rodrigues(axis)[0]
    height = generator.uniform(40.0, 150.0)

    def transform(pixels: Points) -> Points:
        rays = cv2.undistortPoints(pixels.reshape(-1, 1, 2), matrix, lens)[:, 0]
        rays = np.column_stack([rays, np.ones(len(rays))]) @ rotation.T
        return rays[:, :2] * (height / -rays[:, 2:])

    return transform, height / focal


CAMERAS = (draw_terms_camera, draw_pinhole_camera)


def fit_rival(
    name: str, pixels: Points, ground: Points, places: Float[Array, "k 2"]
) -> Float[Array, "k 2"]:
    """Place pixels on the ground by a rival's transform.

    Args:
        name: one of RIVALS.
        pixels: (M, 2) of the control points.
        ground: (M, 2) of the control points, metres.
        places: (K, 2) pixels to place.

    Returns:
        (K, 2) metres.
    """
    if name == "plain homography":
        return transform_points(cv2.findHomography(pixels, ground)[0], places)
    gcps = [
        GroundControlPoint(row=v, col=u, x=x, y=y)
        for (u, v), (x, y) in zip(pixels, ground, strict=True)
    ]
    with GCPTransformer(gcps, tps=name == "GDAL thin plate") as transformer:
        x, y = transformer.xy(places[:, 1], places[:, 0], offset="ul")
    return np.column_stack([x, y])


def _pick_points(
    transform: Callable[[Points], Points],
    resolution: float,
    noise: str,
    count: int,
    generator: np.random.Generator,
) -> ControlPoints:
    """Points in one of the layouts, with picking noise on their pixels."""
    box = np.reshape(LAYOUTS[generator.integers(3)], (2, 2)) * [WIDTH, HEIGHT]
    pixels = generator.uniform(box[0], box[1], size=(count, 2))
    ground = transform(pixels)
    if noise == "one wrong":
        angle, size = generator.uniform(0.0, 2.0 * np.pi), generator.uniform(*np.log10(WRONG_PX))
        ground[0] += 10.0**size * resolution * np.array([np.cos(angle), np.sin(angle)])
    errors = generator.normal(size=pixels.shape)
    if noise == "heavy tails":
        errors /= np.sqrt(generator.chisquare(HEAVY_DOF, (count, 1)) / HEAVY_DOF)
    errors *= np.exp(generator.uniform(*np.log(NOISE_PX)))
    names = tuple(f"p{i}" for i in range(count))
    picked = (pixels + errors).clip(0.0, (WIDTH, HEIGHT))
    return ControlPoints(picked, ground, None, names, (None,) * count)


def measure_row(noise: str, count: int, trials: int, seed: int) -> dict[str, Any]:
    """Measure one row of the table, at the image's corners.

    Args:
        noise: one of NOISES.
        count: number of points.
        trials: sets of points.
        seed: random seed.

    Returns:
        Percentage of sets that are refused; of the others the percentage of corners in the stated
        95 % region, how many times too wide that is in the median, and the median errors, px.
    """
    generator = np.random.default_rng([seed, count, NOISES.index(noise)])
    corners = image_corners(HEIGHT, WIDTH)
    stated: list[Array] = []
    errors: dict[str, list[Array]] = {name: [] for name in ("geoaim", *RIVALS)}
    for trial in range(trials):
        transform, resolution = CAMERAS[trial % len(CAMERAS)](generator)
        points = _pick_points(transform, resolution, noise, count, generator)
        truth = transform(corners)
        try:
            found = estimate_georeference(points, height=HEIGHT, width=WIDTH)
        except GeoreferenceError:
            continue
        pixels, ground = points.pixels, points.coordinates
        places = {name: fit_rival(name, pixels, ground, corners) for name in RIVALS}
        places["geoaim"] = world_from_pixels(found, corners)
        for name, place in places.items():
            errors[name].append(np.linalg.norm(place - truth, axis=1) / resolution)
        stated.append(predict_uncertainty(found, corners)[1] / resolution)
    own, bound = np.array(errors["geoaim"]), np.array(stated)
    return {
        "noise": noise,
        "points": count,
        "refused, %": round(100 * (1 - len(stated) / trials), 1),
        "inside stated 95 %, %": round(100 * float((own <= bound).mean()), 1) if stated else None,
        "times too wide": round(float(np.median(bound / own)) / EXACT_RATIO, 2) if stated else None,
        **{
            f"{name}, px": round(float(np.nanmedian(error)), 1) if stated else None
            for name, error in errors.items()
        },
    }


def draw_chart(rows: list[Row]) -> Figure:
    """Draw errors of each method and the share in the stated region by number of points."""
    figure = Figure(figsize=(12, 6.5), layout="constrained")
    axes = figure.subplots(2, len(NOISES), sharex=True, sharey="row")
    for column, noise in enumerate(NOISES):
        own = [row for row in rows if row["noise"] == noise]
        counts = [row["points"] for row in own]
        top, bottom = axes[:, column]
        for name in ("geoaim", *RIVALS):
            top.plot(counts, [row[f"{name}, px"] for row in own], "o-", label=name)
        top.set(title=noise, yscale="log")
        bottom.axhspan(93, 98, color="0.9", label="93 to 98 %")
        for key in ("inside stated 95 %, %", "refused, %"):
            bottom.plot(counts, [row[key] for row in own], "o-", label=key.removesuffix(", %"))
        bottom.set(ylim=(0, 101), xlabel="control points")
    axes[0, 0].set_ylabel("median error at the corners, px")
    axes[1, 0].set_ylabel("%")
    axes[0, -1].legend(fontsize=8)
    axes[1, -1].legend(fontsize=8)
    return figure


def main(
    json: JsonFile = None,
    chart: ChartFile = None,
    trials: Annotated[int, typer.Option(help="sets of points for each row")] = 60,
    seed: Annotated[int, typer.Option(help="random seed")] = 2,
) -> None:
    """Measure errors, refusals and stated regions by noise and number of points."""
    warnings.simplefilter("ignore", GeoaimWarning)
    cells = [(noise, count) for noise in NOISES for count in POINT_COUNTS]
    rows = print_rows(measure_row(*cell, trials, seed) for cell in cells)
    if json is not None:
        command = f"python -m geoaim.bench.georeference --trials {trials} --seed {seed}"
        write_json({"command": command, "rows": rows}, json)
    if chart is not None:
        write_figure(draw_chart(rows), chart)


if __name__ == "__main__":
    typer.run(main)
