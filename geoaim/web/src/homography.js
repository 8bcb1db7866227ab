/** Homographies of pixels as rows of numbers. */

/** Where a homography puts a pixel. */
export function project(matrix, [u, v]) {
  const [x, y, w] = matrix.map(([a, b, c]) => a * u + b * v + c);
  return [x / w, y / w];
}

/** How it turns and scales around a pixel: {angle, scale}; the angle is counter-clockwise. */
export function linearize(matrix, [u, v]) {
  const [here, right, down] = [[u, v], [u + 1, v], [u, v + 1]].map((pixel) => project(matrix, pixel));
  const [a, c] = [right[0] - here[0], right[1] - here[1]];
  const [b, d] = [down[0] - here[0], down[1] - here[1]];
  return { angle: -Math.atan2(c - b, a + d), scale: Math.sqrt(Math.abs(a * d - b * c)) };
}

/** The inverse of a homography, up to its scale. */
export function invert([[a, b, c], [d, e, f], [g, h, i]]) {
  return [
    [e * i - f * h, c * h - b * i, b * f - c * e],
    [f * g - d * i, a * i - c * g, c * d - a * f],
    [d * h - e * g, b * g - a * h, a * e - b * d],
  ];
}
