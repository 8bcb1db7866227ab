"""Examples to train on: pictures as cameras take them, and what the network shall say of them."""

import cv2
import numpy as np
from jaxtyping import Bool, Float, Float32, UInt8
from numpy import ndarray as Array

from benchmarks.detection.network import STRIDE

LENGTH, WIDTH = 4.5, 1.85  # metres: sizes are learned as logarithms of shares of them
HIDDEN, GONE = 0.5, 0.85  # shares hidden: between them a vehicle counts neither way


def degrade(
    image: UInt8[Array, "H W 3"], generator: np.random.Generator
) -> Float32[Array, "3 H W"]:
    """Change a picture as light, haze, optics, compression and coarse pixels do; 0 to 1."""
    g = generator
    x: Array = image.astype(np.float32) / 255
    if g.uniform() < 0.15:
        x = x[..., g.permutation(3)]
    hsv = cv2.cvtColor(x, cv2.COLOR_RGB2HSV)
    hsv[..., 1] = np.clip(hsv[..., 1] * g.uniform(0.2, 1.4), 0, 1)
    hsv[..., 0] = (hsv[..., 0] + g.normal(0, 12)) % 360
    x = cv2.cvtColor(hsv, cv2.COLOR_HSV2RGB)
    x = np.clip(x, 1e-3, 1) ** np.float32(np.exp(g.normal(0, 0.3)))
    x = (x - x.mean()) * np.exp(g.normal(-0.1, 0.3)) + x.mean() + g.normal(0, 0.08)
    x = x * np.exp(g.normal(0, 0.04, 3)) + g.normal(0, 0.015, 3)
    x = x.astype(np.float32)
    if g.uniform() < 0.5:
        x = cv2.GaussianBlur(x, (0, 0), g.uniform(0.3, 0.9))
    if g.uniform() < 0.35:
        x = x + np.float32(g.uniform(0.3, 1.3)) * (
            x - cv2.GaussianBlur(x, (0, 0), g.uniform(0.6, 1.3))
        )
    size = x.shape[1::-1]
    coarse = g.uniform(1.1, 2.0) if g.uniform() < 0.35 else 1.0
    if coarse > 1:
        x = cv2.resize(x, None, fx=1 / coarse, fy=1 / coarse, interpolation=cv2.INTER_AREA)
    noise = g.standard_normal(x.shape, np.float32) * np.float32(g.uniform(0, 0.04))
    x = np.clip(x + noise, 0, 1)
    if g.uniform() < 0.6:
        x = _compress(x, int(g.integers(35, 95)))
    if coarse > 1:
        how = cv2.INTER_CUBIC if g.uniform() < 0.6 else cv2.INTER_LINEAR
        x = np.clip(cv2.resize(x, size, interpolation=how), 0, 1)
    return np.ascontiguousarray(x.transpose(2, 0, 1), np.float32)


def _compress(x: Array, quality: int) -> Array:
    options = [cv2.IMWRITE_JPEG_QUALITY, quality]
    again = cv2.imdecode(cv2.imencode(".jpg", (x * 255).astype(np.uint8), options)[1], 1)
    assert again is not None
    return again / np.float32(255)


def flip_and_turn(
    image: Array, boxes: Float[Array, "M 5"], generator: np.random.Generator
) -> tuple[Array, Float[Array, "M 5"]]:
    """Turn a square picture by quarters and perhaps mirror it, with its boxes."""
    side, boxes = image.shape[0], boxes.copy()
    if generator.uniform() < 0.5:
        image, boxes[:, 0], boxes[:, 2] = image[:, ::-1], side - boxes[:, 0], np.pi - boxes[:, 2]
    for _ in range(generator.integers(4)):  # a quarter counter-clockwise
        image = np.rot90(image)
        u, v = boxes[:, 0].copy(), boxes[:, 1].copy()
        boxes[:, 0], boxes[:, 1], boxes[:, 2] = v, side - u, boxes[:, 2] - np.pi / 2
    return np.ascontiguousarray(image), boxes


def make_target(
    boxes: Float[Array, "M 5"], hidden: Float[Array, " M"], pixels: int, resolution: float
) -> tuple[Float32[Array, "9 C C"], Float32[Array, "C C"], Float32[Array, "C C"]]:
    """Make what the network shall answer.

    Args:
        boxes: u, v, heading clockwise from right, length, width; pixels.
        hidden: the share of each that is hidden.
        pixels: side of the picture.
        resolution: metres per pixel that the network is told.

    Returns:
        Heat (1 at the cell nearest to a vehicle's middle) and the geometry; where the geometry
        counts; where the heat counts.
    """
    cells = pixels // STRIDE
    target = np.zeros((9, cells, cells), np.float32)
    near_all, weight = np.zeros((cells, cells), np.float32), np.ones((cells, cells), np.float32)
    down, right = np.mgrid[:cells, :cells] * STRIDE + STRIDE / 2
    for (u, v, heading, length, width), share in zip(boxes, hidden, strict=True):
        if share > GONE or not (-length < u < pixels + length and -length < v < pixels + length):
            continue
        reach = int(length / STRIDE) + 2
        i, j = int(v // STRIDE), int(u // STRIDE)
        part = np.s_[max(i - reach, 0) : max(i + reach, 0), max(j - reach, 0) : max(j + reach, 0)]
        du, dv = right[part] - u, down[part] - v
        if not du.size:
            continue
        c, s = np.cos(heading), np.sin(heading)
        along, across = du * c + dv * s, -du * s + dv * c
        if share > HIDDEN:
            weight[part][(abs(along) < length / 2) & (abs(across) < width / 2)] = 0
            continue
        spread = max(0.14 * length, 0.5 * STRIDE), max(0.18 * width, 0.42 * STRIDE)
        heat = np.exp(-0.5 * ((along / spread[0]) ** 2 + (across / spread[1]) ** 2))
        if heat.max() > 0.4:
            heat[heat == heat.max()] = 1
        near = heat > np.maximum(target[0][part], 0.25)
        near_all[part][near] = 1
        values: tuple[Array, ...]
        values = (-du / STRIDE, -dv / STRIDE, np.log(length * resolution / LENGTH))
        values += (
            np.log(width * resolution / WIDTH),
            np.cos(2 * heading),
            np.sin(2 * heading),
            c,
            s,
        )
        for k, value in enumerate(values):
            target[k + 1][part][near] = (value + 0 * du)[near]
        target[0][part] = np.maximum(target[0][part], heat)
    return target, near_all, weight


def make_upright_target(
    bounds: Float[Array, "M 4"],
    ignored: Bool[Array, " M"],
    known: Bool[Array, "N N"],
    resolution: float,
) -> tuple[Float32[Array, "9 C C"], Float32[Array, "C C"], Float32[Array, "C C"]]:
    """Make what the network shall answer where only upright boxes are known.

    Args:
        bounds: left, top, right, bottom; pixels.
        ignored: which count neither way.
        known: which pixels lie in the picture.
        resolution: metres per pixel.

    Returns:
        As `make_target`, with the logarithms of the width and height of the bounds (m) in place
        of length and width.
    """
    cells = known.shape[0] // STRIDE
    target, near_all = np.zeros((9, cells, cells), np.float32), np.zeros((cells, cells), np.float32)
    weight = known[::STRIDE, ::STRIDE].astype(np.float32)
    down, right = np.mgrid[:cells, :cells] * STRIDE + STRIDE / 2
    for (left, top, end, bottom), skip in zip(bounds, ignored, strict=True):
        u, v, wide, high = (left + end) / 2, (top + bottom) / 2, end - left, bottom - top
        du, dv = right - u, down - v
        inside = (abs(du) < wide / 2) & (abs(dv) < high / 2)
        if skip:
            weight[inside] = 0
            continue
        spread = max(0.17 * min(wide, high), 0.45 * STRIDE)
        heat = np.exp(-0.5 * (du**2 + dv**2) / spread**2)
        if 0 < u < known.shape[1] and 0 < v < known.shape[0] and heat.max() > 0.4:
            heat[heat == heat.max()] = 1
        # where along an oblique vehicle its middle is not, the box does not tell
        weight[inside & (heat < 0.3) & (target[0] < 0.3)] *= 0.3
        near = heat > np.maximum(target[0], 0.25)
        near_all[near] = 1
        values = (-du / STRIDE, -dv / STRIDE, np.log(wide * resolution), np.log(high * resolution))
        for k, value in enumerate(values):
            target[k + 1][near] = (value + 0 * du)[near]
        target[0] = np.maximum(target[0], heat)
    weight[target[0] > 0.99] = np.maximum(
        weight[target[0] > 0.99], known[::STRIDE, ::STRIDE][target[0] > 0.99]
    )
    return target, near_all, weight
