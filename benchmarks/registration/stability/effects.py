"""Effects on finished images: what lens, sensor, codec and overlays do to them.

An effect takes the image, its level, the clip's seed and the number of the frame. What is static in
the video is drawn from the clip's seed alone.
"""

from collections.abc import Callable
from io import BytesIO

import av
import cv2
import numpy as np
from jaxtyping import UInt8
from numpy import ndarray as Array

from benchmarks.registration.stability.motion import REFERENCE_WIDTH

Image = UInt8[Array, "_ _ ..."]  # grey or RGB
Effect = Callable[[Image, float, int, int], Image]
WHOLE_VIDEO = {"overlay", "letterbox", "dust", "noise", "night", "flicker", "saturated"}
WHOLE_VIDEO |= {"inset", "dark shadows"}


def apply_effects(
    frames: list[Image], effects: tuple[tuple[str, float], ...], seed: int
) -> tuple[list[Image], list[int]]:
    """Apply effects to a clip; those of single frames spare the first one.

    Args:
        frames: the clip.
        effects: names and levels.
        seed: seed of the clip.

    Returns:
        The frames, and the number of the original frame that each of them shows.
    """
    shown = list(range(len(frames)))
    for name, level in effects:
        if name == "compression":
            frames = _compress(frames, level)
        elif name == "freeze":
            start = int(np.random.default_rng(seed).integers(len(frames) // 2))
            width = round(level * frames[0].shape[1])
            frozen = frames[start][:, :width]
            frames = frames[:start] + [np.hstack([frozen, f[:, width:]]) for f in frames[start:]]
        elif name in ("double", "drop"):
            generator = np.random.default_rng(seed)
            chosen = generator.random(len(shown)) < level
            chosen[:2] = False
            if name == "drop":
                kept = [i for i in range(len(shown)) if not chosen[i]]
            else:
                kept = [i - int(chosen[i]) for i in range(len(shown))]
            frames, shown = [frames[i] for i in kept], [shown[i] for i in kept]
        else:
            first = 0 if name in WHOLE_VIDEO else 1
            changed = [EFFECTS[name](f, level, seed, i) for i, f in enumerate(frames)]
            frames = frames[:first] + changed[first:]
    return frames, shown


def _compress(frames: list[Image], megabits: float) -> list[Image]:
    """Encode by H.264 at a bit rate, which is for 1080p and falls with the area, and decode."""
    height, width = frames[0].shape[:2]
    bits = int(megabits * 1e6 * height * width / (1080 * 1920))
    limits = {"maxrate": str(bits), "bufsize": str(bits // 2), "preset": "fast", "g": "30"}
    file = BytesIO()
    with av.open(file, "w", format="mp4") as container:
        stream = container.add_stream("libx264", 30, options=limits)
        stream.width, stream.height, stream.pix_fmt, stream.bit_rate = (
            width,
            height,
            "yuv420p",
            bits,
        )
        stream.thread_count = 1
        for frame in frames:
            form = "gray" if frame.ndim == 2 else "rgb24"
            container.mux(stream.encode(av.VideoFrame.from_ndarray(frame, format=form)))
        container.mux(stream.encode(None))
    file.seek(0)
    form = "gray" if frames[0].ndim == 2 else "rgb24"
    with av.open(file, "r") as coded:
        return [frame.to_ndarray(format=form) for frame in coded.decode(video=0)]


def _blur(image: Image, level: float, seed: int, index: int) -> Image:
    return cv2.GaussianBlur(image, (0, 0), level * _get_unit(image))


def _blur_motion(image: Image, level: float, seed: int, index: int) -> Image:
    """Average along a straight path, centred on the pixel."""
    generator = np.random.default_rng([seed, index])
    length = level * _get_unit(image)
    side = 2 * int(np.ceil(length / 2)) + 3
    kernel = np.zeros((side, side), np.float32)
    angle = generator.uniform(0, np.pi)
    steps = np.linspace(-length / 2, length / 2, 8 * side)
    x, y = side // 2 + steps * np.cos(angle), side // 2 + steps * np.sin(angle)
    for column, row in ((0, 0), (0, 1), (1, 0), (1, 1)):
        left, top = np.floor(x).astype(int) + column, np.floor(y).astype(int) + row
        np.add.at(kernel, (top, left), (1 - np.abs(x - left)) * (1 - np.abs(y - top)))
    return cv2.filter2D(image, -1, kernel / kernel.sum())


def _add_noise(image: Image, level: float, seed: int, index: int) -> Image:
    generator = np.random.default_rng([seed, index])
    noise = generator.standard_normal(image.shape, np.float32)
    return _to_bytes(image + np.float32(level) * noise)


def _darken(image: Image, level: float, seed: int, index: int) -> Image:
    """Night: little light, sensor noise, and lamps that saturate."""
    generator = np.random.default_rng(seed)
    dark = image * np.float32(level) + 4
    noise = np.random.default_rng([seed, index]).standard_normal(image.shape, np.float32)
    return _to_bytes(dark + noise * np.float32(generator.uniform(2, 4)))


def _expose(image: Image, level: float, seed: int, index: int) -> Image:
    return cv2.convertScaleAbs(image, alpha=level if index % 2 else 1 / level)


def _add_fog(image: Image, level: float, seed: int, index: int) -> Image:
    generator = np.random.default_rng(seed)
    coarse = generator.uniform(-1, 1, (4, 6)).astype(np.float32)
    height, width = image.shape[:2]
    drift = np.array([[1, 0, 2.0 * index], [0, 1, 0]], np.float32)
    cloud = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    cloud = cv2.warpAffine(cloud, drift, (width, height), borderMode=cv2.BORDER_REFLECT)
    share = np.clip(level * (1 + 0.15 * cloud), 0, 1)
    return _to_bytes(image * (1 - share) + 205 * share)


def _code_jpeg(image: Image, level: float, seed: int, index: int) -> Image:
    coded = cv2.imencode(".jpg", image, [cv2.IMWRITE_JPEG_QUALITY, int(level)])[1]
    return np.asarray(cv2.imdecode(coded, cv2.IMREAD_UNCHANGED), np.uint8)


def _overlay_text(image: Image, level: float, seed: int, index: int) -> Image:
    """Boxes of text that stay in place in the frame."""
    generator = np.random.default_rng(seed)
    image, (height, width) = image.copy(), image.shape[:2]
    covered = np.zeros((height, width), bool)
    while covered.mean() < level:
        left, top = (
            int(generator.uniform(0, 0.85) * width),
            int(generator.uniform(0, 0.95) * height),
        )
        right, bottom = left + width // 5, top + height // 14
        covered[top:bottom, left:right] = True
        image[top:bottom, left:right] = 25
        text = "".join(generator.choice(list("ABCDEFGHKLMNPRSTUVX0123456789.:"), 12))
        size = height / 640
        place = (left + 4, bottom - height // 50)
        cv2.putText(image, text, place, cv2.FONT_HERSHEY_SIMPLEX, size, 235, 2, cv2.LINE_AA)
    return image


def _letterbox(image: Image, level: float, seed: int, index: int) -> Image:
    image, bar = image.copy(), round(level * len(image) / 2)
    image[:bar] = image[len(image) - bar :] = 0
    return image


def _cast_shadow(image: Image, level: float, seed: int, index: int) -> Image:
    """A cloud's shadow with a hard edge that moves on from frame to frame."""
    height, width = image.shape[:2]
    angle = np.random.default_rng(seed).uniform(0, 2 * np.pi)
    columns, rows = np.arange(width) / width - 0.5, np.arange(height)[:, None] / height - 0.5
    position = columns * np.cos(angle) + rows * np.sin(angle) + 0.5 + 0.006 * index
    return _to_bytes(image * np.where(position < level, 0.3, 1.0).astype(np.float32))


def _cast_dark_shadows(image: Image, level: float, seed: int, index: int) -> Image:
    """Hard shadows of small clouds over two fifths of the image, which move on together."""
    height, width = image.shape[:2]
    coarse = np.random.default_rng(seed).uniform(0, 1, (9, 18)).astype(np.float32)
    field = cv2.resize(coarse, (2 * width, height), interpolation=cv2.INTER_CUBIC)
    left = round(0.006 * width * index)
    shadow = field[:, left : left + width] < np.quantile(field, 0.4)
    return _to_bytes(image * np.where(shadow, level, 1.0).astype(np.float32))


def _insert_still(image: Image, level: float, seed: int, index: int) -> Image:
    """A picture that does not move on a share of the width: blocks of many sizes."""
    generator = np.random.default_rng(seed)
    image, height, width = image.copy(), len(image), round(level * image.shape[1])
    still = generator.normal(110, 15, (height, width)).astype(np.float32)
    for _ in range(int(300 * level)):
        left, top = generator.integers(0, width), generator.integers(0, height)
        right, bottom = np.array([left, top]) + generator.integers(5, 120, 2)
        still[top:bottom, left:right] += generator.normal(0, 40)
    image[:, :width] = _to_bytes(cv2.GaussianBlur(still, (0, 0), 1.0))
    return image


def _invert(image: Image, level: float, seed: int, index: int) -> Image:
    inverted = np.random.default_rng([seed, index]).random() < level
    return 255 - image if inverted else image


def _add_dust(image: Image, level: float, seed: int, index: int) -> Image:
    generator = np.random.default_rng(seed)
    image, (height, width) = image.copy(), image.shape[:2]
    for _ in range(int(level)):
        centre = int(generator.uniform(0, width)), int(generator.uniform(0, height))
        cv2.circle(image, centre, int(generator.uniform(2, 10)), 60, -1, cv2.LINE_AA)
    return image


def _saturate(image: Image, level: float, seed: int, index: int) -> Image:
    """Reflections of the sun, which travel with the camera and glitter."""
    generator = np.random.default_rng(seed)
    coarse = generator.uniform(0, 1, (9, 16)).astype(np.float32)
    height, width = image.shape[:2]
    field = cv2.resize(coarse, (width, height), interpolation=cv2.INTER_CUBIC)
    limit = np.quantile(field, level) + 0.02 * np.sin(1.7 * index)
    return np.where(field < limit, np.uint8(255), image)


def _flicker(image: Image, level: float, seed: int, index: int) -> Image:
    phase = np.random.default_rng([seed, index]).uniform(0, 2 * np.pi)
    rows = np.arange(len(image))[:, None] / len(image)
    return _to_bytes(image * (1 + level * np.sin(2 * np.pi * 3 * rows + phase)).astype(np.float32))


def _cast_colour(image: Image, level: float, seed: int, index: int) -> Image:
    gains = 1 + level * np.random.default_rng([seed, index]).uniform(-1, 1, 3)
    return _to_bytes(image[..., None] * gains.astype(np.float32))


def _disperse(image: Image, level: float, seed: int, index: int) -> Image:
    """Red is larger and blue smaller by the level at the corners; green stays."""
    height, width = image.shape[:2]
    offset = level * _get_unit(image) / np.hypot(height, width) * 2
    channels = []
    for growth in (1 + offset, 1.0, 1 - offset):
        middle = (1 - growth) * (np.array([width, height]) - 1) / 2
        matrix = np.array([[growth, 0, middle[0]], [0, growth, middle[1]]])
        channels.append(
            cv2.warpAffine(image, matrix, (width, height), borderMode=cv2.BORDER_REFLECT)
        )
    return np.dstack(channels)


def _get_unit(image: Image) -> float:
    """Pixels of this image per pixel of one of the reference width."""
    return image.shape[1] / REFERENCE_WIDTH


def _to_bytes(image: Array) -> Image:
    return np.rint(image).clip(0, 255).astype(np.uint8)


EFFECTS: dict[str, Effect] = {
    "blur": _blur,
    "motion blur": _blur_motion,
    "noise": _add_noise,
    "night": _darken,
    "gain": _expose,
    "fog": _add_fog,
    "jpeg": _code_jpeg,
    "overlay": _overlay_text,
    "letterbox": _letterbox,
    "shadow": _cast_shadow,
    "dark shadows": _cast_dark_shadows,
    "inset": _insert_still,
    "negative": _invert,
    "dust": _add_dust,
    "saturated": _saturate,
    "flicker": _flicker,
    "cast": _cast_colour,
    "chromatic": _disperse,
}
