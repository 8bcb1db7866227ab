"""Find other placements of a frame that a part of the image supports.

A local search accepts the first placement on which enough patches agree. Coherent traffic and
periodic texture offer more than one. The phase correlation of the reference and the registered
frame shows them all at once: a peak for each displacement that a part of the image has.
`placements.py` chooses between them.
"""

from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Complex, Float, Int, UInt8
from numpy import ndarray as Array

from geoaim.geometry import to_opencv, translation

MAX_RIVALS = 3
MIN_RIVAL_STRENGTH = 0.03  # of the peak at zero
MIN_RIVAL_SIGNIFICANCE = 8.0  # standard deviations of the correlation
PEAK_RADIUS_PX = 2  # within which there is no other peak, pixels of the small image
SMOOTHING_PX = 0.7  # of the peaks, pixels of the small image
DETAIL_SIDE_PX = 9  # of the window whose mean is subtracted, pixels of the small image
COMPARED_SIDE_PX = 7  # of the window in which details are compared, pixels of the small image
CLEAR_DIFFERENCE = 0.6  # ratio of the two differences below which a pixel fits clearly better


class Overview(NamedTuple):
    """A small image of the reference, prepared for phase correlation.

    Attributes:
        spectrum: its Fourier transform, whitened and low-pass filtered.
        detail: its grey levels minus their local means.
        window: that fades the image's margins.
        scale: pixels of the small image per pixel of the full image.
    """

    spectrum: Complex[Array, "h k"]
    detail: Float[Array, "h w"]
    window: Float[Array, "h w"]
    scale: float


class Rival(NamedTuple):
    """Another placement of a frame.

    Attributes:
        reference_from_frame: in pixels of the full image.
        strength: of its peak in the phase correlation, relative to that of the placement found.
    """

    reference_from_frame: Float[Array, "3 3"]
    strength: float


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
        (spectrum * smoothing).astype(np.complex64), _extract_detail(small), window, scale
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
    surface = correlate_phases(overview, small, reference_from_frame)
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


def correlate_phases(
    overview: Overview, small: UInt8[Array, "h w"], reference_from_frame: Float[Array, "3 3"]
) -> Float[Array, "h w"]:
    """Correlate the phases of the reference and of a registered frame.

    Args:
        overview: of the reference.
        small: the frame, reduced like the overview.
        reference_from_frame: of the frame, in pixels of the full image.

    Returns:
        The correlation: a peak at row y, column x says that a part of the frame belongs x pixels
        of the small image further right and y further down; negative shifts count from the end.
    """
    height, width = overview.window.shape
    centred = small.astype(np.float32) - small.mean(dtype=np.float32)
    moved = _warp(overview, centred, reference_from_frame)
    return scipy.fft.irfft2(
        overview.spectrum * _whiten(moved * overview.window).conj(), s=(height, width)
    )


def compare_areas(
    overview: Overview,
    small: UInt8[Array, "h w"],
    one: Float[Array, "3 3"],
    other: Float[Array, "3 3"],
) -> tuple[float, float]:
    """Compare how much of the image fits clearly better at one of two placements.

    Args:
        overview: of the reference.
        small: the frame, reduced like the overview.
        one: `reference_from_frame` of the first placement, in pixels of the full image.
        other: `reference_from_frame` of the second one.

    Returns:
        Shares of the area seen in both that fit clearly better at the first and at the second
        placement.
    """
    detail = _extract_detail(small)
    size = (COMPARED_SIDE_PX, COMPARED_SIDE_PX)
    seen = np.ones(small.shape, bool)
    differences = []
    for matrix in (one, other):
        seen &= _warp(overview, np.ones_like(detail), matrix) > 1 - 1e-3
        moved = _warp(overview, detail, matrix)
        differences.append(cv2.blur(np.abs(overview.detail - moved), size))
    if not seen.any():
        return 1.0, 0.0
    first, second = (difference[seen] for difference in differences)
    noise = 0.5 * min(float(np.median(first)), float(np.median(second)))
    return (
        float((first < CLEAR_DIFFERENCE * second - noise).mean()),
        float((second < CLEAR_DIFFERENCE * first - noise).mean()),
    )


def _warp(
    overview: Overview, small: Float[Array, "h w"], reference_from_frame: Float[Array, "3 3"]
) -> Float[Array, "h w"]:
    scale = np.diag([overview.scale, overview.scale, 1.0])
    matrix = scale @ reference_from_frame @ np.linalg.inv(scale)
    return cv2.warpPerspective(small, to_opencv(matrix), overview.window.shape[::-1])


def _extract_detail(small: UInt8[Array, "h w"]) -> Float[Array, "h w"]:
    intensity = small.astype(np.float32)
    return intensity - cv2.blur(intensity, (DETAIL_SIDE_PX, DETAIL_SIDE_PX))


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
