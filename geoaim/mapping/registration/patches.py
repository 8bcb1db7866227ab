"""Align a frame to a reference by small patches, to a fraction of a pixel.

The alignment is inverse compositional (Baker and Matthews 2004): all that depends only on the
reference is computed once, so that an iteration is one small remap and one matrix product. Each
patch measures its displacement, independent of local gain and bias, and the motion is fitted
robustly to the displacements: patches on vehicles and shadows become outliers.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, Shaped, UInt8
from numpy import ndarray as Array

from geoaim.base.geometry import image_corners, to_opencv, transform_points
from geoaim.mapping.registration.motion_models import (
    Model,
    Motion,
    compute_basis,
    fit_motion,
    jackknife_covariance,
)

PATCH_SIDE_PX = 13  # 9 halves the range of convergence, 17 covers more vehicles
PATCH_COUNT = 340  # aimed at: one for each cell of a grid over the reference
PATCH_MOTION_SIGMA_PX = 0.03  # how far a patch may move by itself: parallax, lens, rolling shutter
MIN_FIT_CORRELATION = 0.25  # correlation of a patch that takes part in the fit
MIN_INLIER_CORRELATION = 0.5  # correlation of a patch that counts as an inlier
MIN_FITTED_PATCHES = 10
MAX_STEP_PX = 4 * PATCH_SIDE_PX  # a larger step is a divergence
CONVERGED_STEP_PX = 0.1  # a smaller step ends the iteration; the error left is about a tenth of it
MAX_SATURATED_SHARE = 0.3  # share of a usable patch's pixels that may be 255
MAX_PATCH_NOISE_PX = 0.25  # how far image noise may displace a usable patch
MIN_INLIER_LIMIT_PX, MAX_INLIER_LIMIT_PX = 0.3, 1.5  # residual of an inlier, three sigma between


@dataclass(frozen=True, eq=False)
class PatchTemplate:
    """The reference as patches, prepared for the search in a frame."""

    height: int  # height of this pyramid level, pixels
    width: int  # width of this pyramid level, pixels
    scale: float  # pixels of this level per pixel of the full image
    points: Float[Array, "M 2"]  # patch centres in pixels of this level
    pixels: Float[
        Array, "3 Q"
    ]  # homogeneous positions of all pixels of the patches (OpenCV's origin)
    contrast: Float[Array, "M P"]  # the patches minus their means
    energy: Float[Array, " M"]  # sums of squares of `contrast`
    extractor: Float[Array, "M 3 P"]  # maps a sampled patch to its displacement and gain
    # inverse gradient matrix of each patch, orthogonal to gain and bias
    inverse: Float[Array, "M 2 2"]


@dataclass(frozen=True, eq=False)
class PatchAlignment:
    """A frame aligned to a template."""

    matrix: Float[Array, "3 3"]  # reference_from_frame in pixels of the full image
    # the last fit; residuals and covariance are in pixels of the template's pyramid level
    motion: Motion
    in_view: Bool[Array, " M"]  # patches that lie inside the frame and are not saturated there
    fitted: Bool[Array, " M"]  # patches that took part in the fit
    inliers: Bool[Array, " M"]  # patches that correlate with the frame and follow the motion
    correlation: Float[Array, " M"]  # correlation of each patch with the frame
    converged: bool  # whether the last step was below 0.1 px or the uncertainty


class _Measurement(NamedTuple):
    """What the patches measure in a frame; displacements (N, 2) and variance (N,) of the fitted."""

    in_view: Bool[Array, " M"]
    fitted: Bool[Array, " M"]
    correlation: Float[Array, " M"]
    displacements: Float[Array, "N 2"]
    variance: Float[Array, " N"]


def shrink_image(grey: UInt8[Array, "H W"], factor: int) -> UInt8[Array, "h w"]:
    """Reduce an image to 1/factor of its size by the means of blocks; the remainder is cut off."""
    if factor == 1:
        return grey
    height, width = grey.shape[0] // factor, grey.shape[1] // factor
    whole = grey[: height * factor, : width * factor]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


def make_template(
    grey: UInt8[Array, "H W"], *, factor: int = 1, exclude: Bool[Array, "H W"] | None = None
) -> PatchTemplate:
    """Choose and prepare the patches of a reference image."""
    level = shrink_image(grey, factor)
    if exclude is not None:
        exclude = cv2.resize(
            exclude.view(np.uint8), level.shape[::-1], interpolation=cv2.INTER_NEAREST
        ).view(bool)
    centres = _find_corners(level, exclude)
    offset = np.arange(PATCH_SIDE_PX) - PATCH_SIDE_PX // 2
    rows = (centres[:, 1, None, None] + offset[:, None]) + 0 * offset
    columns = (centres[:, 0, None, None] + offset) + 0 * offset[:, None]
    contrast = _cut_patches(level, rows, columns)
    energy = np.maximum((contrast**2).sum(1), 1e-6)
    unit = contrast / np.sqrt(energy)[:, None]
    gradient = _compute_gradients(level, rows, columns)
    gradient -= np.einsum("mkp,mp->mk", gradient, unit)[..., None] * unit[:, None]
    structure = gradient @ gradient.transpose(0, 2, 1)
    usable = np.linalg.eigvalsh(structure)[:, 0] > (estimate_noise(level) / MAX_PATCH_NOISE_PX) ** 2
    inverse = np.linalg.inv(structure[usable])
    gain = (unit / np.sqrt(energy)[:, None])[usable, None]
    position = np.stack([columns, rows, np.ones_like(rows)])[:, usable].reshape(3, -1)
    return PatchTemplate(
        height=level.shape[0],
        width=level.shape[1],
        scale=1 / factor,
        points=centres[usable] + 0.5,
        pixels=position.astype(np.float32),
        contrast=contrast[usable].astype(np.float32),
        energy=energy[usable],
        extractor=np.concatenate([inverse @ gradient[usable], gain], axis=1).astype(np.float32),
        inverse=inverse,
    )


def align_patches(
    template: PatchTemplate,
    grey: UInt8[Array, "h w"],
    prior: Float[Array, "3 3"],
    model: Model,
    *,
    iterations: int = 8,
) -> PatchAlignment | None:
    """Refine the transform of a frame to the reference, on one pyramid level."""
    scale = np.diag([template.scale, template.scale, 1.0])
    matrix = scale @ prior @ np.linalg.inv(scale)
    corners = image_corners(template.height, template.width)
    for iteration in range(iterations):
        step = _measure_motion(template, grey, matrix, model, rounds=3 if iteration else 6)
        if step is None:
            return None
        measured, motion, information = step
        matrix = motion.matrix @ matrix
        length = np.abs(transform_points(motion.matrix, corners) - corners).max()
        if not length < MAX_STEP_PX:
            return None
        if length < CONVERGED_STEP_PX:
            break
    points, size = template.points[measured.fitted], (template.height, template.width)
    spread = jackknife_covariance(points, information, motion, size=size)
    motion = replace(motion, covariance=motion.covariance + spread)
    uncertainty = predict_uncertainty(template, motion, corners) * template.scale
    converged = bool(length < max(CONVERGED_STEP_PX, uncertainty))
    matrix = np.linalg.inv(scale) @ matrix @ scale
    return PatchAlignment(
        matrix / matrix[2, 2],
        motion,
        measured.in_view,
        measured.fitted,
        _find_inliers(measured, motion),
        measured.correlation,
        converged,
    )


def predict_uncertainty(
    template: PatchTemplate, motion: Motion, points: Float[Array, "N 2"]
) -> float:
    """Predict the standard deviation of mapped points, root mean square: S = J C J'.

    Criminisi (1997), "Accurate visual metrology from single and multiple uncalibrated images".

    Args:
        template: the template to which the motion was fitted.
        motion: the motion.
        points: (N, 2) points in pixels of the template's pyramid level.

    Returns:
        Pixels of the full image.
    """
    columns = compute_basis(points, motion.model, size=(template.height, template.width))
    variance = np.einsum("mik,kl,mil->m", columns, motion.covariance, columns)
    return float(np.sqrt(variance.mean()) / template.scale)


def _measure_motion(
    template: PatchTemplate,
    grey: UInt8[Array, "h w"],
    reference_from_frame: Float[Array, "3 3"],
    model: Model,
    *,
    rounds: int,
) -> tuple[_Measurement, Motion, Float[Array, "N 2 2"]] | None:
    """Fit the motion to the displacements by their precision (the third value)."""
    measured = _measure_displacements(template, grey, np.linalg.inv(reference_from_frame))
    if measured is None or measured.fitted.sum() < MIN_FITTED_PATCHES:
        return None
    covariance = template.inverse[measured.fitted] * measured.variance[:, None, None]
    covariance[:, (0, 1), (0, 1)] += PATCH_MOTION_SIGMA_PX**2
    information = np.linalg.inv(covariance)
    points, size = template.points[measured.fitted], (template.height, template.width)
    try:
        motion = fit_motion(
            points, measured.displacements, information, model, size=size, rounds=rounds
        )
    except np.linalg.LinAlgError:
        return None
    return measured, motion, information


def _measure_displacements(
    template: PatchTemplate, grey: UInt8[Array, "h w"], frame_from_reference: Float[Array, "3 3"]
) -> _Measurement | None:
    """Sample each patch in the frame; None when no patch lies inside."""
    count, area = template.contrast.shape
    height, width = grey.shape
    # positions are relative to OpenCV's origin on both sides of the transform
    position = to_opencv(frame_from_reference).astype(np.float32) @ template.pixels
    position[:2] /= position[2]
    x, y = position[0].reshape(count, area), position[1].reshape(count, area)
    middle = np.stack([x[:, area // 2], y[:, area // 2]])
    margin = np.minimum(middle, np.array([[width], [height]]) - middle)
    in_view = (margin > PATCH_SIDE_PX / 2).all(0)
    if not np.isfinite(position).all() or not in_view.any():
        return None
    # linear: OpenCV's cubic kernel (a = -0.75) shifts smooth texture by up to 0.047 px
    patch = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    in_view &= (patch >= 255).mean(1) < MAX_SATURATED_SHARE
    patch = _subtract_mean(patch.astype(np.float32))
    extracted = np.matmul(template.extractor, patch[..., None])[..., 0].astype(np.float64)
    gain = extracted[:, 2]
    energy = np.einsum("mp,mp->m", patch, patch).astype(np.float64)
    correlation = gain * np.sqrt(template.energy / np.maximum(energy, 1e-6))
    fitted = in_view & (correlation > MIN_FIT_CORRELATION)
    gain = gain[fitted]
    residual = np.maximum(energy[fitted] / gain**2 - template.energy[fitted], 0.25 * area)
    displacements = extracted[fitted, :2] / gain[:, None]
    return _Measurement(in_view, fitted, correlation, displacements, residual / (area - 4))


def _find_inliers(measured: _Measurement, motion: Motion) -> Bool[Array, " M"]:
    inliers = measured.fitted.copy()
    limit = min(max(3 * motion.noise, MIN_INLIER_LIMIT_PX), MAX_INLIER_LIMIT_PX)
    correlated = measured.correlation[measured.fitted] > MIN_INLIER_CORRELATION
    inliers[measured.fitted] = (np.hypot(*motion.residuals.T) < limit) & correlated
    return inliers


def _find_corners(
    grey: UInt8[Array, "H W"], exclude: Bool[Array, "H W"] | None
) -> Int[Array, "M 2"]:
    """The strongest corner (Shi and Tomasi 1994) of each grid cell, as pixel indices (u, v)."""
    height, width = grey.shape
    border = PATCH_SIDE_PX
    strength = cv2.cornerMinEigenVal(cv2.GaussianBlur(grey, (0, 0), 1.0), PATCH_SIDE_PX)
    if exclude is not None:
        near = cv2.dilate(exclude.view(np.uint8), np.ones((PATCH_SIDE_PX,) * 2, np.uint8))
        strength[near > 0] = -1
    if min(height, width) <= 2 * border:
        return np.empty((0, 2), int)
    cell_area = (height - 2 * border) * (width - 2 * border) / PATCH_COUNT
    step = max(np.sqrt(cell_area), PATCH_SIDE_PX)
    rows = np.linspace(border, height - border, max(int((height - 2 * border) / step), 1) + 1)
    columns = np.linspace(border, width - border, max(int((width - 2 * border) / step), 1) + 1)
    centres = []
    for top, bottom in zip(rows[:-1].astype(int), rows[1:].astype(int), strict=True):
        for left, right in zip(columns[:-1].astype(int), columns[1:].astype(int), strict=True):
            cell = strength[top:bottom, left:right]
            row, column = np.unravel_index(cell.argmax(), cell.shape)
            if cell[row, column] > 0:
                centres.append((left + column, top + row))
    return np.array(centres, int).reshape(-1, 2)


def _cut_patches(
    image: Shaped[Array, "H W"], rows: Int[Array, "M s s"], columns: Int[Array, "M s s"]
) -> Float[Array, "M P"]:
    """The pixels of each patch as a row, minus their mean."""
    return _subtract_mean(
        image[rows, columns].reshape(len(rows), PATCH_SIDE_PX**2).astype(np.float64)
    )


def _compute_gradients(
    level: UInt8[Array, "H W"], rows: Int[Array, "M s s"], columns: Int[Array, "M s s"]
) -> Float[Array, "M 2 P"]:
    """Central differences along x and y in each patch, minus their means."""
    intensity = level.astype(np.float32)
    orders: Sequence[tuple[int, int]] = ((1, 0), (0, 1))
    images = [cv2.Sobel(intensity, cv2.CV_32F, *order, ksize=1) / 2 for order in orders]
    return np.stack([_cut_patches(image, rows, columns) for image in images], axis=1)


def _subtract_mean(patches: Float[Array, "M P"]) -> Float[Array, "M P"]:
    return patches - patches.mean(-1, keepdims=True)


def estimate_noise(grey: UInt8[Array, "H W"], *, least: float = 0.5) -> float:
    """Estimate the standard deviation of the noise, grey levels; not below `least`.

    As Immerkaer (1996), with the median instead of the mean, on which texture has less influence.
    Every second row and column is used, which is enough.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = cv2.filter2D(grey, cv2.CV_32F, mask)[::2, ::2]
    return max(float(np.median(np.abs(response))) / 0.6745 / 6, least)
