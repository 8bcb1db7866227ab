"""Generator of frames by warping: a large still, and layers painted over it, sampled by OpenCV."""

import cv2
import numpy as np
from jaxtyping import Float, Float32, UInt8
from numpy import ndarray as Array

from benchmarks.registration.stability.kinds import Disturbance
from benchmarks.registration.stability.motion import PERIODS, REFERENCE_WIDTH, CameraMotion
from geoaim.base.geometry import translation

Points = Float[Array, "*n 2"]
FINENESS = 2.0  # px of the still for a px of a frame 960 wide; wider frames get less
LENS_BLUR_PX = 0.6
OPAQUE = 255


class WarpedScene:
    """A still with painted layers, under a camera that moves by similarities and tilts.

    `render` gives a grey frame; `ground_from_frame` tells where on the ground its pixels lie.
    """

    def __init__(
        self,
        still: UInt8[Array, "_ _"],
        disturbance: Disturbance,
        motion: CameraMotion,
        size: tuple[int, int],
        generator: np.random.Generator,
    ) -> None:
        """Prepare the still and the layers that the disturbance needs.

        Args:
            still: grey, the ground.
            disturbance: what makes the clip hard.
            motion: motion of the camera.
            size: height and width of the frames, px.
            generator: source of randomness.
        """
        self.size, self.disturbance, self.motion = size, disturbance, motion
        self.unit = size[1] / REFERENCE_WIDTH
        self.fineness = min(FINENESS, still.shape[1] / size[1] / 1.3)
        self.generator = generator
        px = self.fineness * self.unit
        self.speed = generator.uniform(2, 6) * self.unit
        self.heading = generator.uniform(0, 2 * np.pi)
        self.phase = generator.uniform(0, 2 * np.pi, (len(motion.angle), 2))
        self.seam = generator.uniform(0.35, 0.6)
        ground = still
        if disturbance.pattern:
            ground = _paint_pattern(still, disturbance, PERIODS[disturbance.pattern] * px)
        if disturbance.contrast < 1:
            mean = float(ground.mean())
            ground = _to_bytes(mean + disturbance.contrast * (ground - np.float32(mean)))
        blurred = cv2.GaussianBlur(ground, (0, 0), LENS_BLUR_PX * self.fineness)
        self.ground = np.asarray(blurred, np.uint8)
        shape = self.ground.shape
        self.vehicles = self._paint_vehicles(disturbance.traffic, shape, px)
        self.flow = self._paint_vehicles(0.85 if disturbance.flow else 0.0, shape, px)
        self.roofs = self._paint_blocks(disturbance.roofs, (140 * px, 100 * px))
        self.trees = self._paint_blocks(disturbance.trees, (60 * px, 60 * px))
        self.waves = None
        if disturbance.water:
            noise = generator.standard_normal(shape).astype(np.float32)
            swell = np.asarray(cv2.GaussianBlur(noise, (0, 0), 5 * px, sigmaY=2 * px), np.float32)
            ripples = np.asarray(cv2.GaussianBlur(noise, (0, 0), px), np.float32)
            swell = swell / swell.std() + ripples * px
            self.waves = _to_bytes(110 + 30 * swell)

    def ground_from_frame(self, index: int, points: Points) -> Points:
        """Map pixels of a frame to the ground, in frame pixels of the plain view."""
        x, y = self._find_ground(index, points[..., 0], points[..., 1], is_image=False)
        return np.stack([x, y], axis=-1)

    def render(self, index: int) -> UInt8[Array, "H W"]:
        """Render frame `index` of the clip in grey, 0 to 255."""
        height, width = self.size
        columns, rows = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
        x, y = self._find_ground(index, columns, rows, is_image=True)
        image = self._sample(self.ground, x, y).astype(np.float32)
        hard, unit = self.disturbance, self.unit
        if self.waves is not None:
            crests = self._sample(self.waves, x + 2.1 * unit * index, y + 0.8 * unit * index)
            troughs = self._sample(self.waves, x - 0.9 * unit * index, y + 1.7 * unit * index)
            sea = crests * (troughs.astype(np.float32) / 110)
            shore = height * (1 - hard.water) + 12 * unit * np.sin(x / (70 * unit))
            _blend(image, sea, (y - shore + 0.5).clip(0, 1))
        if self.trees is not None:
            bend = 3 * unit * np.sin(self.phase[0, 0] + 1.1 * index + x / (300 * unit))
            crowns = self._sample(self.trees, x + bend, y + 0.5 * bend)
            _blend(image, crowns[..., 0], self._sample(self.trees, x, y)[..., 1] / OPAQUE)
        if self.roofs is not None:
            east, south = 0.15 * self.motion.shift[index]
            roofs = self._sample(self.roofs, x + east, y + south)
            _blend(image, roofs[..., 0], roofs[..., 1] / OPAQUE)
        east, south = self.speed * index * np.array([np.cos(self.heading), np.sin(self.heading)])
        if self.vehicles is not None:
            vehicles = self._sample(self.vehicles, x - east, y - south)
            _blend(image, vehicles[..., 0], vehicles[..., 1] / OPAQUE)
        if self.flow is not None:
            across = (x * np.sin(self.heading) - y * np.cos(self.heading)) / (180 * unit) % 1
            road = ((hard.flow / 2 - np.abs(across - 0.5)) * 180 * unit + 0.5).clip(0, 1)
            vehicles = self._sample(self.flow, x - east, y - south)
            shown = np.where(vehicles[..., 1] > 0, vehicles[..., 0], 70)
            _blend(image, shown, road)
        return _to_bytes(image)

    def _sample(self, layer: UInt8[Array, "..."], x: Array, y: Array) -> UInt8[Array, "..."]:
        """Sample a layer at points of the ground; the plain view is in its middle."""
        height, width = self.size
        left = layer.shape[1] / 2 - self.fineness * width / 2 - 0.5
        top = layer.shape[0] / 2 - self.fineness * height / 2 - 0.5
        return cv2.remap(
            layer,
            (self.fineness * x + left).astype(np.float32),
            (self.fineness * y + top).astype(np.float32),
            cv2.INTER_LINEAR,
            borderMode=cv2.BORDER_REFLECT,
        )

    def _find_ground(
        self, index: int, x: Array, y: Array, *, is_image: bool
    ) -> tuple[Array, Array]:
        """Ground positions of pixels: other camera, interlacing, torn and rolling rows, lens."""
        height, width = self.size
        hard, unit = self.disturbance, self.unit
        x, y = (
            np.asarray(x, np.float32 if is_image else float),
            np.asarray(y, np.float32 if is_image else float),
        )
        columns = x
        if hard.interlaced and is_image:
            parity = np.where(np.floor(y) % 2 == 0, 0.5, -0.5)
            x = x + (hard.interlaced * unit * np.cos(self.phase[index, 0]) * parity).astype(x.dtype)
        if hard.torn and index % 2:
            x = x + np.where(y > self.seam * height, hard.torn * unit, 0).astype(x.dtype)
        if hard.rolling:
            phase, turns = self.phase[index, 0], 0.6 + 0.5 * np.sin(self.phase[index, 1])
            wave = np.sin(phase + 2 * np.pi * turns * y / height)
            x, y = x + hard.rolling * unit * wave, y + 0.5 * hard.rolling * unit * wave
        if hard.lens:
            u, v = x - width / 2, y - height / 2
            stretch = 1 + hard.lens * (u * u + v * v) / (width**2 + height**2) * 4
            x, y = u * stretch + width / 2, v * stretch + height / 2
        matrix = self._ground_from_ideal(index).astype(x.dtype)
        depth = matrix[2, 0] * x + matrix[2, 1] * y + matrix[2, 2]
        east = (matrix[0, 0] * x + matrix[0, 1] * y + matrix[0, 2]) / depth
        south = (matrix[1, 0] * x + matrix[1, 1] * y + matrix[1, 2]) / depth
        if hard.split and is_image:
            other = columns > (1 - hard.split) * width
            late = 9 * np.sin(self.phase[0] + 0.4 * index) * unit
            east = np.where(other, 0.8 * columns + 2 * width + late[0], east)
            south = np.where(other, 0.8 * y + late[1], south)
        return east, south

    def _ground_from_ideal(self, index: int) -> Float[Array, "3 3"]:
        """Similarity with tilt about the middle of the frame."""
        height, width = self.size
        motion = self.motion
        angle, scale = motion.angle[index], motion.scale[index]
        cosine, sine = np.cos(angle) / scale, np.sin(angle) / scale
        turn = np.array([[cosine, -sine, 0], [sine, cosine, 0], [0, 0, 1.0]])
        tilt = np.eye(3)
        tilt[2, :2] = motion.tilt[index] / ((height**2 + width**2) / 4)
        offset = self._compute_offset()
        to_middle = translation(-width / 2, -height / 2)
        east, south = motion.shift[index] + offset
        return translation(width / 2 + east, height / 2 + south) @ turn @ tilt @ to_middle

    def _compute_offset(self) -> Float[Array, "2"]:
        """Start so that the path lies around the middle of the still."""
        shift = self.motion.shift
        return -(shift.min(0) + shift.max(0)) / 2

    def _paint_vehicles(
        self, share: float, shape: tuple[int, ...], px: float
    ) -> UInt8[Array, "_ _ 2"] | None:
        """Paint vehicles of many sizes along the heading until they cover the share."""
        if not share:
            return None
        layer = np.zeros((*shape[:2], 2), np.uint8)
        generator, turn = self.generator, np.rad2deg(self.heading)
        for _ in range(40):
            for _ in range(max(int(share * 0.12 * layer[..., 0].size / (900 * px * px)), 1)):
                centre = generator.uniform(0, shape[1]), generator.uniform(0, shape[0])
                size = generator.uniform(28, 75) * px, generator.uniform(15, 21) * px
                shade = int(generator.integers(20, 245))
                box = cv2.boxPoints((centre, size, turn))
                cv2.fillConvexPoly(
                    layer, (box * 16).astype(np.int32), (shade, OPAQUE), cv2.LINE_AA, 4
                )
                glass = cv2.boxPoints((centre, (0.45 * size[0], 0.7 * size[1]), turn))
                dark = (int(0.4 * shade), OPAQUE)
                cv2.fillConvexPoly(layer, (glass * 16).astype(np.int32), dark, cv2.LINE_AA, 4)
            if (layer[::4, ::4, 1] > 0).mean() >= share:
                break
        return cv2.GaussianBlur(layer, (0, 0), LENS_BLUR_PX * self.fineness)

    def _paint_blocks(
        self, share: float, size: tuple[float, float]
    ) -> UInt8[Array, "_ _ 2"] | None:
        """Cover a share of the ground by blocks with texture from elsewhere on it."""
        if not share:
            return None
        height, width = self.ground.shape
        rows, columns = int(height / size[1]) + 1, int(width / size[0]) + 1
        chosen = (self.generator.permutation(rows * columns) < share * rows * columns) * OPAQUE
        mask = chosen.reshape(rows, columns).astype(np.uint8)
        large = cv2.resize(mask, (width, height), interpolation=cv2.INTER_NEAREST)
        texture = np.ascontiguousarray(self.ground[::-1, ::-1])
        return np.dstack([texture, cv2.GaussianBlur(large, (0, 0), self.fineness)])


def _blend(image: Float32[Array, "H W"], layer: Array, alpha: Array) -> None:
    image += (layer - image) * alpha


def _paint_pattern(
    still: UInt8[Array, "_ _"], disturbance: Disturbance, period: float
) -> UInt8[Array, "_ _"]:
    """Paint a periodic pattern over the still, which stays visible as faint dirt."""
    height, width = still.shape
    x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
    rows: dict[str, float] = {"parking": 5 * period, "panels": 0.6 * period, "tiles": period}
    across = rows[disturbance.pattern]
    line = 0.12 * period
    gap_x = np.minimum(x % period, period - x % period)
    gap_y = np.minimum(y % across, across - y % across)
    if disturbance.pattern == "parking":
        lines = (line / 2 - gap_x + 0.5).clip(0, 1) * ((gap_y - 0.8 * period).clip(0, 1))
        painted = 80 + 130 * lines
    elif disturbance.pattern == "panels":
        painted = 190 - 140 * (np.minimum(gap_x, gap_y) - line / 2 + 0.5).clip(0, 1)
    else:
        painted = 90 + 70 * (np.minimum(gap_x, gap_y) - line / 2 + 0.5).clip(0, 1)
    dirt = still.astype(np.float32) - still.mean()
    inside = np.abs(y / height - 0.5) < disturbance.pattern_share / 2
    shown = np.where(inside, painted + 0.05 * dirt, still)
    return _to_bytes(shown)


def _to_bytes(image: Array) -> UInt8[Array, "_ _"]:
    return np.rint(image).clip(0, 255).astype(np.uint8)
