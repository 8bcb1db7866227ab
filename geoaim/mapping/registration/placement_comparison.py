"""Compare the placement of a frame, its transform to the reference, with all shifted ones.

A local search accepts the first placement on which enough patches agree. Vehicles, overlays and
repeating texture offer others, and a correlation of the reference and the registered frame shows
them all at once, as peaks. `placements.py` decides.
"""

from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Bool, Complex, Float, Int, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import to_opencv, translation
from geoaim.mapping.registration.patches import estimate_noise

PEAK_RADIUS_PX = 2  # two peaks are further apart, pixels of the small image
SMOOTHING_PX = 0.7  # smoothing of peaks and details, pixels of the small image
DETAIL_SIDE_PX = 9  # side of the window whose mean is subtracted, pixels of the small image
MIN_NOISE_VARIANCE = 0.05  # variance; that of rounding to grey levels
# a texture repeats if a greater share of an image is alike at another place of it
REPEATING_SHARE = 0.6


class Overview(NamedTuple):
    """A small image of the reference, prepared for correlation."""

    detail: Float[Array, "h w"]  # detail of even contrast, see `_extract_detail`
    spectrum: Complex[Array, "h k"]  # the Fourier transform of `detail`
    phases: Complex[Array, "h k"]  # the same, whitened and low-pass filtered
    power: Float[Array, "h k"]  # power of `spectrum`, relative to the energy of `detail`
    repeats: bool  # whether the texture repeats
    scale: float  # pixels of the small image per pixel of the full image


class Comparison(NamedTuple):
    """A placement of a frame compared with others, by the area that fits and by phase correlation.

    Matrices are reference_from_frame, in pixels of the full image.
    """

    textured_share: float  # share of the common area that is textured
    competing_fit_ratio: (
        float  # the largest area that fits elsewhere instead, relative to what fits here
    )
    moving: Float[Array, "3 3"]  # placement at which that area fits
    # strength of the strongest other peak in the phase correlation, relative to the one found
    other_peak_strength: float
    other_peak: Float[Array, "3 3"]  # placement of that peak


def make_overview(
    small: UInt8[Array, "h w"], *, scale: float, exclude: Bool[Array, "H W"] | None = None
) -> Overview:
    """Prepare the reference for `compare_placements`."""
    height, width = small.shape
    detail = _extract_detail(small)
    if exclude is not None:
        detail[cv2.resize(exclude.view(np.uint8), small.shape[::-1]) > 0] = 0.0
    spectrum = scipy.fft.rfft2(detail)
    rows, columns = scipy.fft.fftfreq(height)[:, None], scipy.fft.rfftfreq(width)
    smoothing = np.exp(-2 * (np.pi * SMOOTHING_PX) ** 2 * (rows**2 + columns**2))
    phases = (_whiten(spectrum) * smoothing).astype(np.complex64)
    power = np.abs(spectrum) ** 2 / max(float((detail**2).sum()), 1e-9)
    repeats = _find_peak(scipy.fft.irfft2(power, s=(height, width)))[0] > REPEATING_SHARE
    return Overview(detail, spectrum, phases, power, repeats, scale)


def compare_placements(
    overview: Overview, small: UInt8[Array, "h w"], reference_from_frame: Float[Array, "3 3"]
) -> Comparison:
    """Compare a placement with all that are displaced from it.

    Both images are reduced to detail of even contrast, so that their correlation at a displacement
    measures the area that fits there. The autocorrelations are subtracted, so that the likeness of
    an image with itself does not count. The phase correlation selects the right period of repeating
    texture, since periods differ little in area: Kuglin and Hines (1975), "The phase correlation
    image alignment method".
    """
    shape = overview.detail.shape
    scale = np.diag([overview.scale, overview.scale, 1.0])
    matrix = to_opencv(scale @ reference_from_frame @ np.linalg.inv(scale))
    seen = cv2.warpPerspective(np.ones_like(small), matrix, shape[::-1])
    moved = cv2.warpPerspective(_extract_detail(small), matrix, shape[::-1]) * seen
    energy, fit = float((moved**2).sum()), float((moved * overview.detail).sum())
    textured = min(energy, float((overview.detail**2 * seen).sum())) / max(float(seen.sum()), 1.0)
    if fit <= 0:
        return Comparison(textured, np.inf, reference_from_frame, np.inf, reference_from_frame)
    spectrum = scipy.fft.rfft2(moved)
    likeness = (overview.power + np.abs(spectrum) ** 2 / energy) / 2
    others = overview.spectrum * spectrum.conj() / fit - likeness
    share, *moving = _find_peak(scipy.fft.irfft2(others, s=shape))
    surface = scipy.fft.irfft2(overview.phases * _whiten(spectrum).conj(), s=shape)
    main = float(surface[_index_surroundings(surface, 0, 0)].max())
    peak, *other_peak = _find_peak(surface)
    places = [translation(x / overview.scale, y / overview.scale) for x, y in (moving, other_peak)]
    placements = [place @ reference_from_frame for place in places]
    return Comparison(textured, share, placements[0], peak / max(main, 1e-9), placements[1])


def _extract_detail(small: UInt8[Array, "h w"]) -> Float[Array, "h w"]:
    """Grey levels minus their local means, divided by the local deviation and the noise.

    Vehicles and faint ground count alike; what is fainter than the noise counts less.
    """
    side = (DETAIL_SIDE_PX, DETAIL_SIDE_PX)
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), SMOOTHING_PX)
    noise = estimate_noise(small, least=0.0) ** 2 / (4 * np.pi * SMOOTHING_PX**2)
    detail = smooth - cv2.blur(smooth, side)
    return detail / np.sqrt(cv2.blur(detail * detail, side) + max(noise, MIN_NOISE_VARIANCE))


def _whiten(spectrum: Complex[Array, "h k"]) -> Complex[Array, "h k"]:
    magnitude = np.abs(spectrum)
    return spectrum / (magnitude + 0.1 * magnitude.mean() + 1e-6)


def _find_peak(surface: Float[Array, "h w"]) -> tuple[float, int, int]:
    """Height, x and y of the highest peak but the one at zero; negative shifts wrap around."""
    height, width = surface.shape
    others = surface.copy()
    others[_index_surroundings(surface, 0, 0)] = -np.inf
    row, column = divmod(int(others.argmax()), width)
    x, y = (column + width // 2) % width - width // 2, (row + height // 2) % height - height // 2
    return float(surface[row, column]), x, y


def _index_surroundings(
    surface: Float[Array, "h w"], row: int, column: int
) -> tuple[Int[Array, "s 1"], Int[Array, "1 s"]]:
    """Indices of the pixels around a peak, across the image's margins."""
    reach = np.arange(-PEAK_RADIUS_PX, PEAK_RADIUS_PX + 1)
    rows, columns = (row + reach) % surface.shape[0], (column + reach) % surface.shape[1]
    return rows[:, None], columns[None, :]
