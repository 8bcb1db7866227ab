"""Direct sub-pixel alignment of a frame by small patches of the reference.

Inverse compositional (Baker and Matthews 2004): everything that depends on the reference alone
is computed once, so that an iteration is one small remap and one product. Each patch measures
how far it lies from where it should, with local gain and bias left out, and the motion is
fitted to those displacements: a patch that disagrees is a car, a shadow's edge, or noise.
"""

from dataclasses import dataclass

import cv2
import numpy as np
from jaxtyping import Bool, Float, Int, UInt8
from numpy import ndarray as Array

from geoaim.geometry import image_corners, to_opencv, transform_points
from geoaim.mapping.registration.motion_models import Model, Motion, basis, fit_motion

SIDE = 13  # px of a patch; 9 halves the basin, 17 sees more cars
CELLS = 340  # patches wanted: one for each cell of a grid over the reference
LOCAL = 0.03  # px by which a patch may truly move by itself: parallax, lens, rolling shutter
AGREEMENT = 0.5  # least correlation of a patch that agrees
SETTLED = 0.1  # px: a step that ends the iteration, which leaves about a tenth of it
SATURATED = 0.3  # share of a patch's pixels at 255 above which it is not used
TRACKABLE = 0.25  # px: a patch that noise moves by more is not used


@dataclass(frozen=True, eq=False)
class Template:
    """The reference as patches, ready to be found in a frame.

    Attributes:
        points: (M, 2) patch centres in pixels of this level.
        scale: this level's pixels for one of the full image.
        pixels: (3, M * P) homogeneous pixel positions (OpenCV's origin) of all patches.
        contrast: (M, P) the patches less their means.
        energy: (M,) their sums of squares.
        extractor: (M, 3, P) what turns a sampled patch into its displacement and gain.
        inverse: (M, 2, 2) inverse of each patch's gradient matrix, gain and bias left out.
    """

    height: int
    width: int
    scale: float
    points: Float[Array, "M 2"]
    pixels: Float[Array, "3 Q"]
    contrast: Float[Array, "M P"]
    energy: Float[Array, " M"]
    extractor: Float[Array, "M 3 P"]
    inverse: Float[Array, "M 2 2"]


@dataclass(frozen=True, eq=False)
class Alignment:
    """A frame laid on the reference, and how well the patches agree.

    Attributes:
        matrix: (3, 3) reference_from_frame in pixels of the full image.
        motion: the last fit; its residuals and covariance are in pixels of the level.
        seen: (M,) patches of the template that lie inside the frame and are not saturated there.
        fitted: (M,) patches that took part in the fit.
        agree: (M,) those that look like the reference and follow the motion.
        correlation: (M,) of each patch with the frame.
        converged: whether the last step was smaller than the uncertainty.
    """

    matrix: Float[Array, "3 3"]
    motion: Motion
    seen: Bool[Array, " M"]
    fitted: Bool[Array, " M"]
    agree: Bool[Array, " M"]
    correlation: Float[Array, " M"]
    converged: bool


def reduce(grey: UInt8[Array, "H W"], factor: int) -> UInt8[Array, "h w"]:
    """The image at 1/factor of its size, by area."""
    if factor == 1:
        return grey
    height, width = grey.shape[0] // factor, grey.shape[1] // factor
    whole = grey[: height * factor, : width * factor]
    return cv2.resize(whole, (width, height), interpolation=cv2.INTER_AREA)


def make_template(
    grey: UInt8[Array, "H W"],
    *,
    factor: int = 1,
    exclude: Bool[Array, "H W"] | None = None,
) -> Template:
    """Choose and prepare the patches of a reference image.

    Args:
        grey: the reference at full size.
        factor: the level: 1, or by how much the reference is reduced.
        exclude: pixels of the full image that must not be used, such as vehicles.
    """
    level = reduce(grey, factor)
    if exclude is not None:
        exclude = cv2.resize(
            exclude.view(np.uint8), level.shape[::-1], interpolation=cv2.INTER_NEAREST
        ).view(bool)
    centres = _corners_on_a_grid(level, exclude)
    offset = np.arange(SIDE) - SIDE // 2
    rows = (centres[:, 1, None, None] + offset[:, None]) + 0 * offset
    columns = (centres[:, 0, None, None] + offset) + 0 * offset[:, None]

    def patches(image: Array) -> Float[Array, "M P"]:
        return image[rows, columns].reshape(len(centres), SIDE * SIDE).astype(np.float64)

    contrast = _centred(patches(level))
    energy = np.maximum((contrast**2).sum(1), 1e-6)
    unit = contrast / np.sqrt(energy)[:, None]
    intensity = level.astype(np.float32)
    gradient = np.stack(
        [
            _centred(patches(cv2.Sobel(intensity, cv2.CV_32F, *d, ksize=1) / 2))
            for d in ((1, 0), (0, 1))
        ],
        axis=1,
    )
    gradient -= np.einsum("mkp,mp->mk", gradient, unit)[..., None] * unit[:, None]
    structure = gradient @ gradient.transpose(0, 2, 1)
    noise = _noise(level)
    trackable = np.linalg.eigvalsh(structure)[:, 0] > (noise / TRACKABLE) ** 2
    inverse = np.linalg.inv(structure[trackable])
    extractor = np.concatenate(
        [inverse @ gradient[trackable], (unit / np.sqrt(energy)[:, None])[trackable, None]], axis=1
    )
    position = np.stack([columns, rows, np.ones_like(rows)])[:, trackable].reshape(3, -1)
    return Template(
        height=level.shape[0],
        width=level.shape[1],
        scale=1 / factor,
        points=centres[trackable] + 0.5,
        pixels=position.astype(np.float32),
        contrast=contrast[trackable].astype(np.float32),
        energy=energy[trackable],
        extractor=extractor.astype(np.float32),
        inverse=inverse,
    )


def align(
    template: Template,
    grey: UInt8[Array, "h w"],
    prior: Float[Array, "3 3"],
    model: Model,
    *,
    iterations: int = 8,
) -> Alignment | None:
    """Refine `prior`, a reference_from_frame of full-image pixels, on one level of a frame.

    Args:
        template: of the same level as `grey`.
        grey: the frame, reduced like the template.

    Returns:
        The alignment, or None when too few patches lie in the frame to fit the model.
    """
    scale = np.diag([template.scale, template.scale, 1.0])
    matrix = scale @ prior @ np.linalg.inv(scale)
    for iteration in range(iterations):
        sampled = _sample(template, grey, np.linalg.inv(matrix))
        if sampled is None:
            return None
        fitted, displacements, variance, correlation, seen = sampled
        if fitted.sum() < 10:
            return None
        covariance = template.inverse[fitted] * variance[fitted, None, None]
        covariance[:, (0, 1), (0, 1)] += LOCAL**2
        motion = fit_motion(
            template.points[fitted],
            displacements[fitted],
            np.linalg.inv(covariance),
            model,
            size=(template.height, template.width),
            rounds=3 if iteration else 6,
        )
        matrix = motion.matrix @ matrix
        corners = image_corners(template.height, template.width)
        step = np.abs(transform_points(motion.matrix, corners) - corners).max()
        if not step < SIDE * 4:
            return None
        settled = bool(step < max(SETTLED, corner_uncertainty(template, motion) * template.scale))
        if step < SETTLED:
            break
    agree = np.zeros(len(template.points), bool)
    residual = np.hypot(*motion.residuals.T)
    limit = max(3 * motion.noise, 0.3)
    agree[fitted] = (residual < min(limit, 1.5)) & (correlation[fitted] > AGREEMENT)
    matrix = np.linalg.inv(scale) @ matrix @ scale
    matrix /= matrix[2, 2]
    return Alignment(matrix, motion, seen, fitted, agree, correlation, settled)


def corner_uncertainty(template: Template, motion: Motion) -> float:
    """Standard deviation of the mapped image corners in full-image pixels: S = J C J'.

    Criminisi (1997), "Accurate visual metrology from single and multiple uncalibrated images".
    """
    corners = image_corners(template.height, template.width)
    columns = basis(corners, motion.model, size=(template.height, template.width))
    variance = np.einsum("mik,kl,mil->m", columns, motion.covariance, columns)
    return float(np.sqrt(variance.mean()) / template.scale)


def _sample(
    template: Template, grey: UInt8[Array, "h w"], frame_from_reference: Float[Array, "3 3"]
) -> tuple[Array, Array, Array, Array, Array] | None:
    """Look each patch up in the frame: who can be fitted, displacement, its variance, ..."""
    count, area = template.contrast.shape
    height, width = grey.shape
    # Positions are pixel centres (OpenCV's origin) on both sides of the transform.
    there = to_opencv(frame_from_reference).astype(np.float32)
    position = there @ template.pixels
    position[:2] /= position[2]
    x, y = position[0].reshape(count, area), position[1].reshape(count, area)
    middle = np.stack([x[:, area // 2], y[:, area // 2]])
    margin = np.minimum(middle, np.array([[width], [height]]) - middle)
    seen = (margin > SIDE / 2).all(0)
    if not np.isfinite(position).all() or not seen.any():
        return None
    # Linear: the cubic kernel of OpenCV (a = -0.75) shifts smooth texture by up to 0.047 px.
    patch = cv2.remap(grey, x, y, cv2.INTER_LINEAR, borderMode=cv2.BORDER_REPLICATE)
    seen &= (patch >= 255).mean(1) < SATURATED
    patch = _centred(patch.astype(np.float32))
    found = np.matmul(template.extractor, patch[..., None])[..., 0].astype(np.float64)
    gain = found[:, 2]
    energy = np.einsum("mp,mp->m", patch, patch).astype(np.float64)
    correlation = gain * np.sqrt(template.energy / np.maximum(energy, 1e-6))
    fitted = seen & (correlation > 0.25)
    gain = np.where(fitted, gain, 1.0)
    displacements = found[:, :2] / gain[:, None]
    rest = np.maximum(energy / gain**2 - template.energy, 0.25 * area)
    return fitted, displacements, rest / (area - 4), correlation, seen


def _corners_on_a_grid(
    grey: UInt8[Array, "H W"], exclude: Bool[Array, "H W"] | None
) -> Int[Array, "M 2"]:
    """The strongest corner (Shi and Tomasi 1994) of each cell, as whole pixel indices (u, v)."""
    height, width = grey.shape
    border = SIDE
    strength = cv2.cornerMinEigenVal(cv2.GaussianBlur(grey, (0, 0), 1.0), SIDE)
    if exclude is not None:
        near = cv2.dilate(exclude.view(np.uint8), np.ones((SIDE, SIDE), np.uint8))
        strength[near > 0] = -1
    if min(height, width) <= 2 * border:
        return np.empty((0, 2), int)
    step = max(np.sqrt((height - 2 * border) * (width - 2 * border) / CELLS), SIDE)
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


def _centred(patches: Array) -> Array:
    return patches - patches.mean(-1, keepdims=True)


def _noise(grey: UInt8[Array, "H W"]) -> float:
    """Standard deviation of the image noise, at least half a grey level (Immerkaer 1996).

    The median instead of the mean, so that texture counts for less.
    """
    mask = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], np.float32)
    response = cv2.filter2D(grey.astype(np.float32), -1, mask)
    return max(float(np.median(np.abs(response))) / 0.6745 / 6, 0.5)
