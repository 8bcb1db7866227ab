/** Coordinates of a point: metres, longitude and latitude, pixels of the AIM. */

/** Convert metres to [longitude, latitude] by the quadratic of the description. */
export function toLonLat({ center, scale, coefficients }, [x, y]) {
  const [u, v] = [(x - center[0]) / scale, (y - center[1]) / scale];
  const terms = [1, u, v, u * u, u * v, v * v];
  return coefficients.map((row) => row.reduce((sum, value, index) => sum + value * terms[index], 0));
}

/** Apply a 3x3 matrix (rows) to a point. */
export function transformPoint([a, b, c], [x, y]) {
  const [u, v, w] = [a, b, c].map((row) => row[0] * x + row[1] * y + row[2]);
  return [u / w, v / w];
}

/** Describe a point in one line. */
export function describePoint(description, point) {
  const parts = [`x ${point[0].toFixed(2)} m, y ${point[1].toFixed(2)} m`];
  if (description.lonlat) {
    const [longitude, latitude] = toLonLat(description.lonlat, point);
    parts.push(`lat ${latitude.toFixed(7)}, lon ${longitude.toFixed(7)}`);
  }
  if (description.pixels_from_world) {
    const [u, v] = transformPoint(description.pixels_from_world, point);
    parts.push(`pixel ${u.toFixed(1)}, ${v.toFixed(1)}`);
  }
  return parts.join("  ·  ");
}
