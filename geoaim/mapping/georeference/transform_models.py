"""Fit pixels to metres by similarity, affine or homography, and say how far to trust the fit.

All of it in normalised coordinates: image points p = (u - width/2, height/2 - v) / L with L half
the image's diagonal, and world points brought onto them by the best similarity, so that every
parameter is a small plain number: shift and similarity (4), stretch and shear (2), perspective
(2), one radial lens term (1):

    q = (A p' + t) / (1 + c . p'),   p' = p (1 + k |p|^2),   A = [[1+s+a, b-r], [b+r, 1+s-a]]

The points are explained by all nine terms at once, where the last five are expected to be small
(`PRIOR`): that posterior says how far any point of the image may be off, whichever of the plain
models is then chosen for the map. A textbook covariance of the chosen model alone knows nothing of
the tilt that eight clustered points did not show, and is wrong at the corners.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float
from numpy import ndarray as Array

# The plain models, least first, as the terms that each may use.
MODELS = {"similarity": 4, "affine": 6, "homography": 8}
# What a camera looking straight down leaves over, one sigma: stretch and shear 1 %, perspective 5 %
# over half the diagonal (a tilt of 3 degrees), a lens that moves the corners by 0.5 %.
PRIOR = np.array([0.01, 0.01, 0.05, 0.05, 0.005])
GROUPS = ([4, 5], [6, 7], [8])
TAIL = 3.0  # degrees of freedom of the prior (Student's t): what points show clearly is believed
CHANCE = 5.0  # noise variances by which each further term must lower the misfit to be considered
MARGIN = 2.0  # a plainer model's left-out distance may exceed the best by this over the number
DOUBT = 0.005  # a set of points is wrong when chance explains it less often than this
SUSPECT = 0.05  # another point is suspected too when it is at least this likely to be the wrong one


@dataclass(frozen=True)
class Posterior:
    """What the points say about all nine terms.

    Attributes:
        parameters: (9,) most probable values.
        covariance: (9, 9) of the parameters, at the estimated noise.
        precision: (9,) the prior's inverse variances, zero where free.
        noise: standard deviation of one coordinate of one point.
        dof: degrees of freedom behind the noise.
        misfit: residuals, prior and expected noise, squared and summed; what outliers inflate.
    """

    parameters: Float[Array, "9"]
    covariance: Float[Array, "9 9"]
    precision: Float[Array, "9"]
    noise: float
    dof: float
    misfit: float


@dataclass(frozen=True)
class Candidate:
    """One model fitted to the points.

    Attributes:
        model: "similarity", "affine" or "homography".
        parameters: (9,) zero where the model has no such term.
        leave_one_out: (M, 2) errors of each point by a fit without it.
        misfit: squared residuals and prior, in noise variances.
    """

    model: str
    parameters: Float[Array, "9"]
    leave_one_out: Float[Array, "m 2"]
    misfit: float


def apply(parameters: Float[Array, "9"], points: Float[Array, "m 2"]) -> Float[Array, "m 2"]:
    """Map normalised image points by the nine terms."""
    return apply_with_jacobian(parameters, points)[0]


def apply_with_jacobian(
    parameters: Float[Array, "9"], points: Float[Array, "m 2"]
) -> tuple[Float[Array, "m 2"], Float[Array, "m 2 9"]]:
    """Map normalised image points, with the derivative by the nine terms."""
    tx, ty, s, r, a, b, cx, cy, k = parameters
    square = np.sum(points**2, axis=1, keepdims=True)
    bent = points * (1.0 + k * square)
    matrix = np.array([[1.0 + s + a, b - r], [b + r, 1.0 + s - a]])
    below = 1.0 + bent @ np.array([cx, cy])
    mapped = (bent @ matrix.T + (tx, ty)) / below[:, None]
    x, y = bent.T
    jacobian = np.zeros((len(points), 2, 9))
    jacobian[:, 0, 0] = jacobian[:, 1, 1] = 1.0
    jacobian[:, 0, 2], jacobian[:, 0, 3], jacobian[:, 0, 4], jacobian[:, 0, 5] = x, -y, x, y
    jacobian[:, 1, 2], jacobian[:, 1, 3], jacobian[:, 1, 4], jacobian[:, 1, 5] = y, x, -y, x
    jacobian[:, :, 6:8] = -mapped[:, :, None] * bent[:, None, :]
    radial = points * square
    jacobian[:, :, 8] = radial @ matrix.T - mapped * (radial @ (cx, cy))[:, None]
    return mapped, jacobian / below[:, None, None]


def fit_terms(
    points: Float[Array, "m 2"],
    targets: Float[Array, "m 2"],
    terms: list[int],
    ridge: Float[Array, "9"],
    start: Float[Array, "9"] | None = None,
) -> Float[Array, "9"]:
    """Least squares over some of the nine terms, the others zero.

    Gauss-Newton, with shortened steps where it must, on the transfer error from the direct linear
    solution (Hartley and Zisserman 2004, 4.1 and 4.4), which is exact for the linear models.
    `ridge` is the prior's inverse variance times the noise variance.
    """
    theta = _linear_start(points, targets, terms, ridge) if start is None else start
    mapped, jacobian = apply_with_jacobian(theta, points)
    cost = np.sum((targets - mapped) ** 2) + np.sum(ridge * theta**2)
    for _ in range(20):
        design = jacobian.reshape(-1, 9)[:, terms]
        gradient = design.T @ (targets - mapped).ravel() - ridge[terms] * theta[terms]
        step = _inverse(design.T @ design + np.diag(ridge[terms])) @ gradient
        if np.abs(step).max() < 1e-9:
            break
        for shorter in 0.5 ** np.arange(8):
            trial = theta.copy()
            trial[terms] += shorter * step
            mapped, jacobian = apply_with_jacobian(trial, points)
            lower = np.sum((targets - mapped) ** 2) + np.sum(ridge * trial**2)
            if lower <= cost and _in_front(trial, points):
                break
        else:
            return theta
        theta, cost = trial, lower
    return theta


def _linear_start(
    points: Float[Array, "m 2"],
    targets: Float[Array, "m 2"],
    terms: list[int],
    ridge: Float[Array, "9"],
) -> Float[Array, "9"]:
    """The direct linear solution; without the perspective where it puts points on the horizon."""
    _, jacobian = apply_with_jacobian(np.zeros(9), points)
    jacobian[:, :, 6:8] = -targets[:, :, None] * points[:, None, :]
    for some in (terms, terms[:4]):
        design = jacobian.reshape(-1, 9)[:, some]
        normal = design.T @ design + np.diag(ridge[some])
        theta = np.zeros(9)
        theta[some] = _inverse(normal) @ design.T @ (targets - points).ravel()
        if _in_front(theta, points):
            break
    return theta


def _inverse(normal: Float[Array, "k k"]) -> Float[Array, "k k"]:
    """Inverse of a normal matrix, scaled first so that a term nobody saw does not stop it."""
    scale = 1.0 / np.sqrt(np.diag(normal) + 1e-30)
    even = normal * scale * scale[:, None] + 1e-12 * np.eye(len(normal))
    return np.asarray(np.linalg.inv(even) * scale * scale[:, None])


def _in_front(theta: Float[Array, "9"], points: Float[Array, "m 2"]) -> bool:
    return bool((1.0 + points @ theta[6:8]).min() > 0.05)


def fit_posterior(
    points: Float[Array, "m 2"], targets: Float[Array, "m 2"], accuracy: float, trust: float
) -> Posterior:
    """All nine terms with their prior, and the noise.

    The prior's heavy tails are Student's t, by reweighting; the noise is the mean of the residuals'
    variance and of `accuracy` squared, which counts as `trust` degrees of freedom. With no trust
    the residuals alone speak, for any noise from a hundredth of `accuracy` to three times it or
    more.
    """
    width = np.concatenate([np.full(4, np.inf), 5.0 * PRIOR])  # start wide: a large lens is seen
    precision, variance, theta = 1.0 / width**2, accuracy**2, np.full(9, np.nan)
    start = None
    for _ in range(30):
        previous = theta
        theta = fit_terms(points, targets, list(range(9)), precision * variance, start)
        mapped, jacobian = apply_with_jacobian(theta, points)
        normal = jacobian.reshape(-1, 9).T @ jacobian.reshape(-1, 9)
        inverse = _inverse(normal + np.diag(precision * variance))
        freedom = 2 * len(points) - np.trace(inverse @ normal)
        squares = np.sum((targets - mapped) ** 2)
        if trust > 0:
            variance, dof = (trust * accuracy**2 + squares) / (trust + freedom), trust + freedom
        else:
            variance, dof = _noise_by_residuals(float(squares), float(freedom), accuracy)
        for group in GROUPS:
            scale = TAIL * PRIOR[group[0] - 4] ** 2 + np.sum(theta[group] ** 2)
            precision[group] = (TAIL + len(group)) / scale
        if np.abs(theta - previous).max() < 1e-7:
            break
        start = theta
    misfit = trust * accuracy**2 + squares + variance * np.sum(precision * theta**2)
    noise = float(np.sqrt(variance))
    return Posterior(theta, inverse * variance, precision, noise, float(dof), float(misfit))


def _noise_by_residuals(squares: float, freedom: float, accuracy: float) -> tuple[float, float]:
    """Variance of the noise and its degrees of freedom, all orders of size alike beforehand.

    The posterior under a density of 1/sigma, summed over sigma, is matched by the scaled inverse
    chi-square of the same mean and variance (Gelman 2013, Bayesian Data Analysis, 2.6).
    """
    most = max(3.0 * accuracy, 3.0 * float(np.sqrt(squares / max(freedom, 1.0))))
    sigma = np.geomspace(0.01 * accuracy, most, 100)
    log = -freedom * np.log(sigma) - squares / (2.0 * sigma**2)
    weight = np.exp(log - log.max())
    weight /= weight.sum()
    mean = float(weight @ sigma**2)
    spread = float(weight @ (sigma**2 - mean) ** 2)
    dof = 4.0 + 2.0 * mean**2 / max(spread, 1e-12 * mean**2)
    return mean * (dof - 2.0) / dof, dof


def fit_candidates(
    points: Float[Array, "m 2"], targets: Float[Array, "m 2"], posterior: Posterior
) -> list[Candidate]:
    """The plain models, least first, each with its leave-one-out errors.

    With a radial term only when the points show one at three sigma and can carry it (six or more).
    The left-out error of a point is (I - H)^-1 e with H its 2 x 2 block of the hat matrix.
    """
    bend = abs(posterior.parameters[8]) / np.sqrt(posterior.covariance[8, 8])
    radial = bool(len(points) >= 6 and bend > 3.0)
    candidates = []
    for model, size in MODELS.items():
        terms = [*range(size), 8] if radial else list(range(size))
        ridge = posterior.precision * posterior.noise**2
        theta = fit_terms(points, targets, terms, ridge)
        mapped, jacobian = apply_with_jacobian(theta, points)
        squares = np.sum((targets - mapped) ** 2) + np.sum(ridge * theta**2)
        design = jacobian[:, :, terms]
        flat = design.reshape(-1, len(terms))
        inverse = _inverse(flat.T @ flat + np.diag(ridge[terms]))
        free = np.eye(2) * (1.0 + 1e-12) - design @ inverse @ design.transpose(0, 2, 1)
        left_out = np.linalg.solve(free, (targets - mapped)[:, :, None])[:, :, 0]
        candidates.append(Candidate(model, theta, left_out, float(squares / posterior.noise**2)))
    return candidates


def choose(candidates: list[Candidate]) -> Candidate:
    """The least model whose mean leave-one-out distance is near the best.

    Considered are the models that lower the misfit by more than chance. Leave-one-out alone takes
    too rich a model for few points, and AICc or GRIC on plain fits are worse still: see
    `geoaim.bench.georeference`.
    """
    first = candidates[0]
    considered = [first] + [
        c
        for c in candidates[1:]
        if first.misfit - c.misfit >= CHANCE * (MODELS[c.model] - MODELS[first.model])
    ]
    share = 1.0 + MARGIN / len(first.leave_one_out)
    errors = [float(np.linalg.norm(c.leave_one_out, axis=1).mean()) for c in considered]
    return considered[next(i for i, e in enumerate(errors) if e <= share * min(errors))]


def find_suspects(
    points: Float[Array, "m 2"], targets: Float[Array, "m 2"], accuracy: float, trust: float
) -> list[int]:
    """Points of which one must be wrong, the likeliest first; empty when the set is consistent.

    A point is judged by how much the misfit falls when it is left out, an F test with 2 and n
    degrees of freedom (Cook and Weisberg 1982, 2.2.2), Bonferroni over the points.
    """
    posterior = fit_posterior(points, targets, accuracy, trust)
    freedom = trust + 2 * len(points) - 6
    if _looks_clean(points, targets, posterior, freedom):
        return []
    keep = ~np.eye(len(points), dtype=bool)
    without = np.array([fit_posterior(points[k], targets[k], accuracy, trust).misfit for k in keep])
    falls = np.maximum(posterior.misfit / without, 1.0)
    chance = falls.max() ** (-freedom / 2.0)
    if chance * len(points) > DOUBT:
        return []
    likelihood = (without / without.min()) ** (-freedom / 2.0)
    return [int(i) for i in np.argsort(without) if likelihood[i] >= SUSPECT]


def _looks_clean(
    points: Float[Array, "m 2"],
    targets: Float[Array, "m 2"],
    posterior: Posterior,
    freedom: float,
) -> bool:
    """The same test to first order, without refits: settles nearly every clean set."""
    mapped, jacobian = apply_with_jacobian(posterior.parameters, points)
    spread = jacobian @ posterior.covariance @ jacobian.transpose(0, 2, 1) / posterior.noise**2
    error = (targets - mapped)[:, :, None]
    falls = np.sum(error * np.linalg.solve(np.eye(2) * (1.0 + 1e-9) - spread, error), axis=(1, 2))
    left = np.maximum(posterior.misfit - falls.max(), 1e-30)
    chance = (posterior.misfit / left) ** (-freedom / 2.0)
    usual = (np.abs(posterior.parameters[4:]) <= 3.0 * PRIOR).all()
    return bool(usual and chance * len(points) > 0.3)


def ellipse_factor(dof: float, share: float = 0.95) -> float:
    """How many standard deviations the region with that share of a plane's errors reaches.

    sqrt(2 F(2, dof)), whose quantile has a closed form.

    >>> round(ellipse_factor(np.inf), 3)  # Gaussian: sqrt(-2 ln 0.05)
    2.448
    """
    if np.isinf(dof):
        return float(np.sqrt(-2.0 * np.log1p(-share)))
    return float(np.sqrt(dof * np.expm1(-2.0 / dof * np.log1p(-share))))
