"""Generator of frames by evaluating a continuous ground (splines), without warping an image.

The ground is a quadratic B-spline surface, periodic patterns and vehicles are drawn by the share of
a pixel that they cover, waves are sums of sinusoids, and the camera is a pinhole with a pose. No
image is ever warped. No code is shared with `warped.py`.
"""

import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array
from scipy.ndimage import map_coordinates
from scipy.spatial.transform import Rotation

from benchmarks.registration.stability.kinds import Disturbance
from benchmarks.registration.stability.motion import PERIODS, REFERENCE_WIDTH, CameraMotion

KNOT_PX = 1.5  # spacing of the spline's knots on the ground, at the reference width
FOCAL = 1.1  # focal length in widths of the frame
ROOF_HEIGHT = 0.13  # height of the roofs, in heights of the camera
GRAVITY = 9.81 / 0.1 / 900  # px of 0.1 m a squared frame, at 30 frames/s


class SplineScene:
    """A flat ground at height zero, things on and above it, and a pinhole camera.

    `render` gives a grey frame; `ground_from_frame` tells where on the ground its pixels lie.
    """

    def __init__(
        self,
        base: str,
        disturbance: Disturbance,
        motion: CameraMotion,
        size: tuple[int, int],
        generator: np.random.Generator,
    ) -> None:
        """Draw the ground and all that is on it.

        Args:
            base: "town" or "fields".
            disturbance: what makes the clip hard.
            motion: motion of the camera.
            size: height and width of the frames, px.
            generator: source of randomness.
        """
        self.size, self.disturbance, self.motion = size, disturbance, motion
        self.unit = size[1] / REFERENCE_WIDTH
        self.knots = _draw_ground(base, generator)
        if disturbance.contrast < 1:
            self.knots = 110 + disturbance.contrast * (self.knots - 110)
        self.course = generator.uniform(0, 2 * np.pi)
        self.velocity = generator.uniform(2, 6) * np.array(
            [np.cos(self.course), np.sin(self.course)]
        )
        self.vehicles = _place_vehicles(disturbance, size[1] / size[0], generator)
        self.cells = generator.random((2, 64, 64))
        self.waves = generator.uniform(0, 2 * np.pi, (12, 3))
        self.jitter = generator.uniform(-1, 1, (len(motion.angle), 3))
        self.seam = generator.uniform(0.4, 0.65)

    def ground_from_frame(self, index: int, points: Float[Array, "*n 2"]) -> Float[Array, "*n 2"]:
        """Map pixels of a frame to the ground, px of the plain view."""
        ray = self._cast_rays(index, points[..., 0], points[..., 1])
        return np.stack(self._meet(index, *ray, height=0.0), axis=-1) * self.unit

    def render(self, index: int) -> UInt8[Array, "H W"]:
        """Render a grey frame."""
        rows, width = self.size
        v, u = np.mgrid[0.5:rows, 0.5:width].astype(np.float32)
        hard = self.disturbance
        if hard.interlaced:
            offset = np.float32(hard.interlaced * self.unit * self.jitter[index, 0])
            u = u + offset * (np.arange(rows) % 2 - 0.5).astype(np.float32)[:, None]
        ray = self._cast_rays(index, u, v)
        x, y = self._meet(index, *ray, height=0.0)
        if hard.split:
            other = u > (1 - hard.split) * width
            late = 8 * np.sin(0.5 * index + self.waves[0])
            x = np.where(other, np.float32(0.9) * u / self.unit + 3000 + late[0], x)
            y = np.where(other, np.float32(0.9) * v / self.unit + late[1], y)
            x, y = x.astype(np.float32), y.astype(np.float32)
        pixel = float(abs(x[rows // 2, width // 2 + 1] - x[rows // 2, width // 2])) + 1e-3
        image = self._evaluate(x, y)
        if hard.pattern:
            _mix(image, *self._draw_pattern(x, y, image, pixel))
        if hard.water:
            shore = rows / self.unit * (1 - hard.water) + 10 * np.sin(x / 57)
            _mix(image, self._draw_waves(x, y, index), _cover(y - shore, pixel))
        if hard.trees:
            sway = 3 * np.sin(1.3 * index + self.waves[0, 0] + y / 240)
            crowns = self._evaluate(x + 900 + sway, y + 700 - 0.4 * sway)
            _mix(image, crowns, self._cover_cells(x, y, 70.0, hard.trees, layer=0))
        self._draw_vehicles(image, x, y, index, pixel)
        if hard.roofs:
            east, south = self._meet(index, *ray, height=ROOF_HEIGHT)
            roofs = self._evaluate(east + 1300, south + 400)
            _mix(image, roofs, self._cover_cells(east, south, 130.0, hard.roofs, layer=1))
        return np.rint(image).clip(0, 255).astype(np.uint8)

    def _cast_rays(self, index: int, u: Array, v: Array) -> tuple[Array, Array, Array]:
        """Directions in the world of the light that falls on pixels."""
        rows, width = self.size
        hard = self.disturbance
        if hard.torn and index % 2:
            u = u - np.where(v > self.seam * rows, hard.torn * self.unit, 0).astype(u.dtype)
        if hard.rolling:
            phase, turns = np.pi * self.jitter[index, 0], 0.6 + 0.5 * self.jitter[index, 1]
            swing = hard.rolling * self.unit * np.cos(phase + 2 * np.pi * turns * v / rows)
            u, v = u + 0.8 * swing, v + 0.6 * swing
        focal = FOCAL * width
        a, b = (u - width / 2) / focal, (v - rows / 2) / focal
        if hard.lens:
            edge = (width**2 + rows**2) / 4 / focal**2
            bulge = 1 + hard.lens * (a * a + b * b) / edge
            a, b = a * bulge, b * bulge
        turn = self._turn(index).astype(u.dtype)
        ray = [turn[row, 0] * a + turn[row, 1] * b + turn[row, 2] for row in range(3)]
        return ray[0], ray[1], ray[2]

    def _turn(self, index: int) -> Float[Array, "3 3"]:
        """world_from_camera: heading, then the two tilts."""
        diagonal = np.hypot(*self.size) / 2
        tilt = self.motion.tilt[index] * FOCAL * self.size[1] / diagonal**2
        angles = [self.motion.angle[index], -tilt[0], tilt[1]]
        return Rotation.from_euler("ZYX", angles).as_matrix()

    def _meet(
        self, index: int, east: Array, south: Array, down: Array, *, height: float
    ) -> tuple[Array, Array]:
        """Where rays meet the plane at a height, px at the reference width."""
        rows, width = self.size
        altitude = FOCAL * REFERENCE_WIDTH / self.motion.scale[index]
        fall = altitude - height * FOCAL * REFERENCE_WIDTH
        position = (self.motion.shift[index] + [width / 2, rows / 2]) / self.unit
        reach = east.dtype.type(fall) / down
        return (
            reach * east + east.dtype.type(position[0]),
            reach * south + east.dtype.type(position[1]),
        )

    def _evaluate(self, x: Array, y: Array) -> Float32[Array, "H W"]:
        """The spline surface at points of the ground; it repeats far outside of the view."""
        place = [y / np.float32(KNOT_PX) + 400, x / np.float32(KNOT_PX) + 500]
        return np.asarray(
            map_coordinates(
                self.knots, place, order=2, prefilter=False, mode="grid-wrap", output=np.float32
            )
        )

    def _cover_cells(self, x: Array, y: Array, side: float, share: float, *, layer: int) -> Array:
        """Coverage by cells of a grid of which a share is filled, with soft edges."""
        filled = (self.cells[layer] < share).astype(np.float32).repeat(32, 0).repeat(32, 1)
        place = [(y / side + 24) * 32, (x / side + 24) * 32]
        return np.asarray(
            map_coordinates(filled, place, order=1, mode="grid-wrap", output=np.float32)
        )

    def _draw_waves(self, x: Array, y: Array, index: int) -> Array:
        """Deep-water waves, mostly from one side: frequency is the root of gravity by number."""
        water = np.full_like(x, 85)
        for number, (heading, phase, spread) in enumerate(self.waves):
            wavelength = 9 * 1.35**number
            k = 2 * np.pi / wavelength
            angle = self.course + 0.5 * np.sin(heading)
            omega = np.sqrt(GRAVITY * k)
            travel = k * (np.cos(angle) * x + np.sin(angle) * y) - omega * index + phase
            water += (7 + np.sin(spread)) * np.sin(travel)
        return np.where(water > 125, 1.6 * water - 75, water)  # crests glitter

    def _draw_pattern(self, x: Array, y: Array, ground: Array, pixel: float) -> tuple[Array, Array]:
        """A periodic pattern, on which a little dirt does not repeat, and its coverage."""
        pattern, period = self.disturbance.pattern, PERIODS[self.disturbance.pattern]
        along = period / 2 - np.abs(x % period - period / 2)
        rows = {"parking": 4.5 * period, "panels": 1.7 * period, "tiles": period}[pattern]
        across = rows / 2 - np.abs(y % rows - rows / 2)
        if pattern == "parking":
            drawn = 75 + 140 * _cover(1.4 - along, pixel) * _cover(across - 0.7 * period, pixel)
        else:
            gap = np.minimum(along, across) - 0.07 * period
            drawn = 180 - 120 * _cover(gap, pixel)
        middle = self.size[0] / self.unit / 2
        inside = self.disturbance.pattern_share * middle - np.abs(y - middle)
        return drawn + 0.05 * (ground - 110), _cover(inside, pixel)

    def _draw_vehicles(self, image: Array, x: Array, y: Array, index: int, pixel: float) -> None:
        """Vehicles by the share of each pixel that they cover; roads wrap them around."""
        cosine, sine = np.cos(self.course), np.sin(self.course)
        hard, rows, width = self.disturbance, *self.size
        middle = np.array([width, rows]) / self.unit / 2
        along, across = (x - middle[0]) * cosine + (y - middle[1]) * sine, None
        across = (y - middle[1]) * cosine - (x - middle[0]) * sine
        if hard.flow:
            lane = (across / 200) % 1
            _mix(image, np.full_like(image, 65), _cover((hard.flow / 2 - abs(lane - 0.5)) * 200, 1))
        homography = self._find_pixels(index)
        for place, offset, length, breadth, shade in self.vehicles:
            reach = (place + index * np.hypot(*self.velocity) + 1500) % 3000 - 1500
            east = middle[0] + reach * cosine - offset * sine
            south = middle[1] + reach * sine + offset * cosine
            spot = homography @ [east, south, 1]
            spot, radius = spot[:2] / spot[2], 0.6 * length / pixel + 16 * self.unit
            left, top = np.maximum(spot - radius, 0).astype(int)
            right, bottom = (spot + radius).clip(0, [width, rows]).astype(int)
            if left >= right or top >= bottom:
                continue
            part = slice(top, bottom), slice(left, right)
            a, b = along[part] - np.float32(reach), across[part] - np.float32(offset)
            body = _cover(length / 2 - np.abs(a), pixel) * _cover(breadth / 2 - np.abs(b), pixel)
            glass = _cover(0.1 * length - np.abs(np.abs(a) - 0.22 * length), pixel)
            ribs = 0.1 * np.sin(a * (0.4 + 0.003 * shade))
            _mix(image[part], shade * (1 + ribs) * (1 - 0.6 * glass), body)

    def _find_pixels(self, index: int) -> Float[Array, "3 3"]:
        """frame_from_ground without lens and shutter, only to find where to draw."""
        rows, width = self.size
        focal = FOCAL * width
        x, y = (self.motion.shift[index] + [width / 2, rows / 2]) / self.unit
        altitude = FOCAL * REFERENCE_WIDTH / self.motion.scale[index]
        camera = np.array([[focal, 0, width / 2], [0, focal, rows / 2], [0, 0, 1]])
        return camera @ self._turn(index).T @ [[1, 0, -x], [0, 1, -y], [0, 0, altitude]]


def _mix(image: Array, layer: Array, coverage: Array) -> None:
    image += (layer - image) * coverage


def _cover(inside: Array, pixel: float) -> Array:
    """Share of a pixel inside an edge at a signed distance, over 1.4 pixels."""
    return (inside / (1.4 * pixel) + 0.5).clip(0, 1)


def _draw_ground(base: str, generator: np.random.Generator) -> Float32[Array, "1400 2100"]:
    """Knots of the ground: fractal noise, with roads and roofs of a town or with fields."""
    rows, columns = 1400, 2100
    frequency = np.hypot(np.fft.fftfreq(rows)[:, None], np.fft.rfftfreq(columns))
    spectrum = np.fft.rfft2(generator.standard_normal((rows, columns)))
    noise = np.fft.irfft2(spectrum / np.maximum(frequency, 0.004) ** 1.1, s=(rows, columns))
    knots = 110 + 16 * noise / noise.std()
    count = 900 if base == "town" else 60
    for _ in range(count):
        top, left = generator.integers(0, rows - 20), generator.integers(0, columns - 20)
        low, high = (5, 60) if base == "town" else (80, 400)
        height, width = generator.integers(low, high, 2)
        patch = knots[top : top + height, left : left + width]
        strength = 45 if base == "town" else 18
        patch += strength * generator.standard_normal()
    if base == "town":
        for line in range(90, rows, 220):
            knots[line : line + 40] = 70 + 0.3 * (knots[line : line + 40] - 110)
            for dash in range(0, columns, 24):
                knots[line + 19 : line + 21, dash : dash + 11] = 220
    return knots.clip(5, 250).astype(np.float32)


def _place_vehicles(
    disturbance: Disturbance, aspect: float, generator: np.random.Generator
) -> Float[Array, "n 5"]:
    """Place along the course, offset from its middle, length, breadth and grey level of each."""
    share = 0.75 if disturbance.flow else disturbance.traffic
    if not share:
        return np.empty((0, 5))
    breadth = REFERENCE_WIDTH * 0.62
    count = int(-np.log1p(-share) * 3000 * 2 * breadth / (48 * 19))
    vehicles = np.column_stack(
        [
            generator.uniform(-1500, 1500, count),
            generator.uniform(-breadth, breadth, count),
            generator.uniform(28, 70, count),
            generator.uniform(16, 22, count),
            generator.uniform(20, 240, count),
        ]
    )
    if not disturbance.flow:
        return vehicles
    lane = vehicles[:, 1] / 200 % 1
    return vehicles[np.abs(lane - 0.5) < disturbance.flow / 2 - 0.05]
