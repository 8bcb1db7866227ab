"""Find other placements of a frame, and measure how much of the image fits at one.

A local search accepts the first placement on which enough patches agree. Periodic texture offers
more than one. The phase correlation of the reference and the registered frame shows them all at
once, as peaks. `placements.py` decides.
"""

from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int, UInt8
from numpy import ndarray as Array

from geoaim.geometry import to_opencv, translation
from geoaim.mapping.registration.patches import estimate_noise

MAX_RIVALS = 3
MIN_RIVAL_STRENGTH = 0.03  # of the peak at zero
MIN_RIVAL_SIGNIFICANCE = 8.0  # standard deviations of the correlation
PEAK_RADIUS_PX = 2  # within which there is no other peak, pixels of the small image
SMOOTHING_PX = 0.7  # of peaks and details, pixels of the small image
DETAIL_SIDE_PX = 9  # of the window whose mean is subtracted, pixels of the small image
COMPARED_SIZE = (5, 5)  # of the windows in which details are compared, pixels of the small image
MIN_NOISE = 0.05  # variance; that of rounding to grey levels
MIN_TEXTURE = 3.0  # ratio to the noise
MIN_TEXTURE_LEFT = 0.3  # ratio to the noise, when that is subtracted
CLEAR_FIT = 0.7  # of the typical correlation of inliers


class Overview(NamedTuple):
    """A small image of the reference, prepared for phase correlation."""

    spectrum: Complex[Array, "h k"]  # its Fourier transform, whitened and low-pass filtered
    detail: Float[Array, "h w"]  # its grey levels, smoothed, minus their local means
    noise: float  # variance of the noise in `detail`
    window: Float[Array, "h w"]  # that fades the image's margins
    scale: float  # pixels of the small image per pixel of the full image


class Rival(NamedTuple):
    """Another placement of a frame."""

    reference_from_frame: Float[Array, "3 3"]  # in pixels of the full image
    strength: float  # of its peak in the phase correlation, relative to that of the placement found


def make_overview(small: UInt8[Array, "h w"], *, scale: float) -> Overview:
    """Prepare the reference for `find_rivals`.

    Args:
        small: the reference, reduced.
        scale: pixels of `small` per pixel of the full image.

    Returns:
        The overview.
    """
    height, width = small.shape
    window = cv2.createHanningWindow((width, height), cv2.CV_32F) ** 0.5
    spectrum = _whiten((small - small.mean()) * window)
    rows, columns = scipy.fft.fftfreq(height)[:, None], scipy.fft.rfftfreq(width)
    smoothing = np.exp(-2 * (np.pi * SMOOTHING_PX) ** 2 * (rows**2 + columns**2))
    return Overview(
        (spectrum * smoothing).astype(np.complex64), *_extract_detail(small), window, scale
    )


def find_rivals(
    overview: Overview, small: UInt8[Array, "h w"], reference_from_frame: Float[Array, "3 3"]
) -> list[Rival]:
    """Find other placements of a frame, displaced from the given one, strongest first.

    Kuglin and Hines (1975), "The phase correlation image alignment method".

    Args:
        overview: of the reference.
        small: the frame, reduced like the overview.
        reference_from_frame: the placement found, in pixels of the full image.

    Returns:
        The rivals.
    """
    surface = _correlate_phases(overview, small, reference_from_frame)
    height, width = surface.shape
    main, noise = float(surface[_index_surroundings(surface, 0, 0)].max()), float(surface.std())
    surface[_index_surroundings(surface, 0, 0)] = 0
    rivals = []
    for _ in range(MAX_RIVALS):
        row, column = divmod(int(surface.argmax()), width)
        peak = float(surface[row, column])
        if peak < max(MIN_RIVAL_STRENGTH * main, MIN_RIVAL_SIGNIFICANCE * noise):
            break
        surface[_index_surroundings(surface, row, column)] = 0
        x = (column + width // 2) % width - width // 2
        y = (row + height // 2) % height - height // 2
        shift = translation(x / overview.scale, y / overview.scale)
        rivals.append(Rival(shift @ reference_from_frame, peak / main))
    return rivals


def _correlate_phases(
    overview: Overview, small: UInt8[Array, "h w"], reference_from_frame: Float[Array, "3 3"]
) -> Float[Array, "h w"]:
    """Correlate the phases of the reference and of a registered frame.

    A peak at row y, column x says that a part of the frame belongs x pixels of the small image
    further right and y further down; negative shifts count from the end.
    """
    height, width = overview.window.shape
    centred = small.astype(np.float32) - small.mean(dtype=np.float32)
    moved = _warp(overview, centred, reference_from_frame)
    return scipy.fft.irfft2(
        overview.spectrum * _whiten(moved * overview.window).conj(), s=(height, width)
    )


def measure_fit(
    overview: Overview,
    small: UInt8[Array, "h w"],
    reference_from_frame: Float[Array, "3 3"],
    points: Float[Array, "M 2"],
) -> tuple[float, float]:
    """Measure how much of the image has texture, and how much of that fits at a placement.

    Details are correlated in small windows, less what noise contributes. A window fits if it
    correlates nearly as well as those of the inliers, so that blur or compression of the whole
    image is no misfit.

    Args:
        overview: of the reference.
        small: the frame, reduced like the overview.
        reference_from_frame: the placement, in pixels of the full image.
        points: patches of the reference that follow it, in pixels of the full image.

    Returns:
        The share of the common area that has texture, and the share of that which fits.
    """
    detail, noise = _extract_detail(small)
    moved = _warp(overview, detail, reference_from_frame)
    seen = _warp(overview, np.ones_like(detail), reference_from_frame) > 1 - 1e-3
    energies = []
    textured = np.zeros(seen.shape, bool)
    for image, own_noise in ((overview.detail, overview.noise), (moved, noise)):
        energy = cv2.blur(image * image, COMPARED_SIZE)
        textured |= energy > MIN_TEXTURE * own_noise
        energies.append(np.maximum(energy - own_noise, MIN_TEXTURE_LEFT * own_noise))
    product = cv2.blur(overview.detail * moved, COMPARED_SIZE)
    correlation = product / np.sqrt(energies[0] * energies[1])
    window = np.ones(COMPARED_SIZE[::-1], np.uint8)
    seen = cv2.erode(seen.view(np.uint8), window, borderValue=1).view(bool)
    textured &= seen
    if not textured.any():
        return 0.0, 0.0
    columns, rows = (points * overview.scale).astype(int).T
    limits = np.array([[seen.shape[1] - 1], [seen.shape[0] - 1]])
    columns, rows = np.minimum([columns, rows], limits)
    typical = min(float(np.median(correlation[rows, columns])), 1.0)
    fits = correlation[textured] > CLEAR_FIT * typical
    return float(textured.sum() / seen.sum()), float(fits.mean())


def _warp(
    overview: Overview, small: Float[Array, "h w"], reference_from_frame: Float[Array, "3 3"]
) -> Float[Array, "h w"]:
    scale = np.diag([overview.scale, overview.scale, 1.0])
    matrix = scale @ reference_from_frame @ np.linalg.inv(scale)
    return cv2.warpPerspective(small, to_opencv(matrix), overview.window.shape[::-1])


def _extract_detail(small: UInt8[Array, "h w"]) -> tuple[Float[Array, "h w"], float]:
    """Grey levels minus their local means, smoothed, and the variance of the noise in them."""
    smooth = cv2.GaussianBlur(small.astype(np.float32), (0, 0), SMOOTHING_PX)
    noise = estimate_noise(small, least=0.0) ** 2 / (4 * np.pi * SMOOTHING_PX**2)
    return smooth - cv2.blur(smooth, (DETAIL_SIDE_PX, DETAIL_SIDE_PX)), max(noise, MIN_NOISE)


def _whiten(image: Float[Array, "h w"]) -> Complex[Array, "h k"]:
    spectrum = scipy.fft.rfft2(image.astype(np.float32))
    magnitude = np.abs(spectrum)
    return spectrum / (magnitude + 0.01 * magnitude.mean() + 1e-6)


def _index_surroundings(
    surface: Float[Array, "h w"], row: int, column: int
) -> tuple[Int[Array, "s 1"], Int[Array, "1 s"]]:
    """Indices of the pixels around a peak, across the image's margins."""
    reach = np.arange(-PEAK_RADIUS_PX, PEAK_RADIUS_PX + 1)
    rows, columns = (row + reach) % surface.shape[0], (column + reach) % surface.shape[1]
    return rows[:, None], columns[None, :]
