/** Measuring of distances on the map. */
import Draw from "ol/interaction/Draw.js";
import VectorLayer from "ol/layer/Vector.js";
import VectorSource from "ol/source/Vector.js";
import { Fill, Stroke, Style } from "ol/style.js";
import CircleStyle from "ol/style/Circle.js";

const COLOUR = "#00c2ff";

/** Add a tool that measures lines; returns `toggle(on)`. `report` gets the length in metres. */
export function addMeasure(map, report) {
  const source = new VectorSource();
  const stroke = new Stroke({ color: COLOUR, width: 2.5 });
  const style = new Style({ stroke, image: new CircleStyle({ radius: 4, fill: new Fill({ color: COLOUR }) }) });
  map.addLayer(new VectorLayer({ source, style, zIndex: 20 }));
  const draw = new Draw({ source, type: "LineString", style });
  draw.on("drawstart", ({ feature }) => {
    source.clear();
    feature.getGeometry().on("change", ({ target }) => report(target.getLength()));
  });
  return (on) => {
    source.clear();
    if (on) map.addInteraction(draw);
    else map.removeInteraction(draw);
  };
}
