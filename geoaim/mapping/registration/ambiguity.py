"""Decide whether the placement of a frame, its transform to the reference, is unambiguous.

A frame is rejected if too large a part of the image fits at another placement: coherent traffic,
overlays, water, another view on a part of the screen. A correlation of the reference and the
registered frame shows all placements at once, as peaks.
"""

from typing import NamedTuple

import cv2
import numpy as np
import scipy.fft
from jaxtyping import Bool, Complex, Float, Int, UInt8
from numpy import ndarray as Array

from geoaim.base.errors import GeoaimError
from geoaim.base.geometry import image_corners, to_opencv, transform_points, translation
from geoaim.mapping.registration.patches import (
    PatchAlignment,
    PatchTemplate,
    align_patches,
    estimate_noise,
    shrink_image,
)

# chosen on the validation part of `benchmarks.registration.stability`
MIN_TEXTURED_SHARE = 0.4  # smallest textured share of the image
MAX_COMPETING_FIT_RATIO = 0.13  # share of the image that may fit at another placement
# more if a camera hovers, so that the rest moves at least twice as far as the placement
MAX_COMPETING_FIT_RATIO_HOVERING = 0.45
# less if the placement does not move at all, like overlays and frozen images
MAX_COMPETING_FIT_RATIO_AT_REST = 0.065
MAX_REST_SHIFT_PX = 0.05  # mean displacement of the corners
MAX_FROZEN_SHIFT_PX = 0.005  # from the frame before; of a calm drone 1 % of the frames move less
# a camera that hovers moves more; frozen blocks of H.264 move less
MIN_HOVERING_SHIFT_PX = 1.0
# another placement that is nearer does not count unless it fits nearly as well: roofs and trees
# from an aeroplane, whose distance the stated uncertainty includes
MIN_COMPETING_DISTANCE_PX = 5.0
MAX_NEAR_FIT_RATIO = 0.65
MIN_MOVING_SHARE = 0.025  # that tells another placement from chance
MAX_OTHER_PEAK_STRENGTH = 0.4  # of another peak in the phase correlation, relative to the one found

MOVING_PART = "a part moves by itself"  # begins the reason of a rejection


PEAK_RADIUS_PX = 2  # two peaks are further apart, pixels of the small image
SMOOTHING_PX = 0.7  # smoothing of peaks and details, pixels of the small image
DETAIL_SIDE_PX = 9  # side of the window whose mean is subtracted, pixels of the small image
MIN_NOISE_VARIANCE = 0.05  # variance; that of rounding to grey levels
# a texture repeats if a greater share of an image is alike at another place of it
REPEATING_SHARE = 0.6
# by how much patches, or blocks of the image, must fit better than a period away, standard errors
MIN_PATCH_GAIN = 3.0
MIN_BLOCK_GAIN = 4.5  # more, since neighbouring blocks err together
BLOCK_SIDE_PX = 32


class Overview(NamedTuple):
    """A small image of the reference, prepared for correlation."""

    detail: Float[Array, "h w"]  # detail of even contrast, see `_extract_detail`
    spectrum: Complex[Array, "h k"]  # the Fourier transform of `detail`
    phases: Complex[Array, "h k"]  # the same, whitened and low-pass filtered
    power: Float[Array, "h k"]  # power of `spectrum`, relative to the energy of `detail`
    period: Float[Array, "2"] | None  # where the texture repeats, pixels (u, v) of the full image
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


class AmbiguousPlacementError(GeoaimError):
    """The image does not tell which placement of a frame is right."""


def choose_placement(
    reference: UInt8[Array, "H W"],
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    overview: Overview,
    alignment: PatchAlignment,
    *,
    rests: bool,
) -> tuple[PatchAlignment, Float[Array, "3 3"] | None]:
    """Accept a placement unless another fits nearly as well, or less if it `rests`.

    On repeating texture it is first moved to the period that fits best.
    """
    small = shrink_image(grey, round(1 / overview.scale))
    compared = compare_placements(overview, small, alignment.matrix)
    if compared.other_peak_strength > 1:
        other = align_patches(template, grey, compared.other_peak, alignment.motion.model)
        if other is not None and other.converged:
            alignment, compared = other, compare_placements(overview, small, other.matrix)
    if compared.textured_share < MIN_TEXTURED_SHARE:
        raise AmbiguousPlacementError(
            f"too little texture: on {compared.textured_share:.0%} of the image"
        )
    limit, travel = MAX_COMPETING_FIT_RATIO, _measure_travel(alignment.matrix, template)
    if rests:
        limit = MAX_COMPETING_FIT_RATIO_AT_REST
    elif _measure_distance(compared.moving, alignment.matrix, template) < MIN_COMPETING_DISTANCE_PX:
        limit = MAX_NEAR_FIT_RATIO
    elif travel > MIN_HOVERING_SHIFT_PX and _measure_travel(compared.moving, template) > 2 * travel:
        limit = MAX_COMPETING_FIT_RATIO_HOVERING
    if compared.competing_fit_ratio > limit:
        share = min(compared.competing_fit_ratio, 1.0)
        raise AmbiguousPlacementError(
            f"{MOVING_PART}: another placement fits {share:.0%} as much of the image"
        )
    strongest = MAX_OTHER_PEAK_STRENGTH
    if (
        _measure_distance(compared.other_peak, alignment.matrix, template)
        < MIN_COMPETING_DISTANCE_PX
    ):
        strongest = MAX_NEAR_FIT_RATIO
    if compared.other_peak_strength > strongest:
        raise AmbiguousPlacementError("texture repeats: another placement fits as well")
    if overview.period is not None:
        _check_periods(reference, grey, template, overview.period, alignment)
    moves = compared.competing_fit_ratio > MIN_MOVING_SHARE and overview.period is None
    return alignment, compared.moving if moves else None


def _check_periods(
    reference: UInt8[Array, "H W"],
    grey: UInt8[Array, "H W"],
    template: PatchTemplate,
    period: Float[Array, "2"],
    alignment: PatchAlignment,
) -> None:
    """Raise unless the image fits better at a placement than a period away on either side.

    Where nothing but the repeating texture is seen, it fits as well there. Patches see dirt on the
    texture, blocks of the whole image what lies beside it; either suffices.
    """
    for shift in (period, -period):
        start = translation(*shift) @ alignment.matrix
        other = align_patches(template, grey, start, alignment.motion.model)
        if other is None:
            continue
        both = alignment.in_view & other.in_view
        patches = (alignment.correlation - other.correlation)[both]
        blocks = _compare_blocks(reference, grey, alignment.matrix, other.matrix)
        if not (_is_gain(patches, MIN_PATCH_GAIN) or _is_gain(blocks, MIN_BLOCK_GAIN)):
            raise AmbiguousPlacementError("texture repeats: a period away it fits as well")


def _is_gain(gain: Float[Array, "..."], least: float) -> bool:
    """Whether the mean exceeds so many standard errors of itself; also without any value."""
    return gain.size == 0 or bool(gain.mean() > least * gain.std() / np.sqrt(gain.size))


def _compare_blocks(
    reference: UInt8[Array, "H W"],
    grey: UInt8[Array, "H W"],
    one: Float[Array, "3 3"],
    other: Float[Array, "3 3"],
) -> Float[Array, "h w"]:
    """By how much the detail of each block differs more at the other placement, grey levels."""
    height, width = grey.shape
    warps = [to_opencv(matrix) for matrix in (one, other)]
    seen = [cv2.warpPerspective(np.ones_like(grey), warp, (width, height)) > 0 for warp in warps]
    errors = []
    for warp in warps:
        moved = cv2.warpPerspective(grey, warp, (width, height)).astype(np.float32)
        difference = np.where(seen[0] & seen[1], moved - reference, 0)
        detail = difference - cv2.blur(difference, (BLOCK_SIDE_PX, BLOCK_SIDE_PX))
        blocks = width // BLOCK_SIDE_PX, height // BLOCK_SIDE_PX
        errors.append(np.sqrt(cv2.resize(detail**2, blocks, interpolation=cv2.INTER_AREA)))
    return errors[1] - errors[0]


def is_at_rest(
    alignment: PatchAlignment, template: PatchTemplate, before: Float[Array, "3 3"]
) -> bool:
    """Whether a placement is that of the reference or of the frame `before`.

    So are overlays and frozen images.
    """
    return (
        _measure_travel(alignment.matrix, template) < MAX_REST_SHIFT_PX
        or _measure_distance(alignment.matrix, before, template) < MAX_FROZEN_SHIFT_PX
    )


def _measure_travel(reference_from_frame: Float[Array, "3 3"], template: PatchTemplate) -> float:
    """Mean displacement of the image's corners, pixels."""
    return _measure_distance(reference_from_frame, np.eye(3), template)


def _measure_distance(
    one: Float[Array, "3 3"], other: Float[Array, "3 3"], template: PatchTemplate
) -> float:
    """Mean distance of the image's corners at two placements, pixels."""
    corners = image_corners(template.height, template.width)
    return float(
        np.hypot(*(transform_points(one, corners) - transform_points(other, corners)).T).mean()
    )


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
    likeness, *shift = _find_peak(scipy.fft.irfft2(power, s=(height, width)))
    period = np.array(shift) / scale if likeness > REPEATING_SHARE else None
    return Overview(detail, spectrum, phases, power, period, scale)


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
