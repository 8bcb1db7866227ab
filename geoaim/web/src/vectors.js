/** Lines and areas of a map: HD map, drivable area. */
import Feature from "ol/Feature.js";
import MultiLineString from "ol/geom/MultiLineString.js";
import MultiPolygon from "ol/geom/MultiPolygon.js";
import VectorLayer from "ol/layer/Vector.js";
import VectorSource from "ol/source/Vector.js";
import { Fill, Stroke, Style } from "ol/style.js";

/** Make the layer of lines or polygons (an item of `shapes` in the description). */
export function makeShapesLayer(shapes) {
  const { colour, width = 1.5, dash = null } = shapes;
  const geometry = shapes.polygons
    ? new MultiPolygon(shapes.polygons)
    : new MultiLineString(shapes.lines);
  const style = new Style({
    stroke: new Stroke({ color: colour, width, lineDash: dash }),
    fill: shapes.polygons ? new Fill({ color: shapes.fill }) : undefined,
  });
  const source = new VectorSource({ features: [new Feature(geometry)] });
  return new VectorLayer({ source, style, visible: shapes.visible });
}
