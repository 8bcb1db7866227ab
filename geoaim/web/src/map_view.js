/** The view of a map in metres. */
import Projection from "ol/proj/Projection.js";
import View from "ol/View.js";

/** Make a map's view and projection: metres of the world, x east and y north. */
export function makeMapView(extent) {
  const projection = new Projection({ code: "geoaim", units: "m", extent, getPointResolution: (r) => r });
  return new View({ projection, center: [0, 0], resolution: 1, constrainRotation: false, showFullExtent: true });
}
