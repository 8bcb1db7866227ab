/** Measuring of distances on the map, and the scale that a known length gives. */
import Draw from "ol/interaction/Draw.js";
import VectorLayer from "ol/layer/Vector.js";
import VectorSource from "ol/source/Vector.js";
import { Fill, Stroke, Style } from "ol/style.js";
import CircleStyle from "ol/style/Circle.js";
import { make } from "./dom.js";

const COLOUR = "#00c2ff";

/**
 * Add a tool that measures lines; returns its `toggle(on)` and its element.
 *
 * `report` gets the length in metres. On a map whose scale is not known surely, `resolution` is its
 * metres per pixel: the element asks for the true length, and says which resolution is right.
 */
export function addMeasure(map, report, resolution = null) {
  const source = new VectorSource();
  const stroke = new Stroke({ color: COLOUR, width: 2.5 });
  const style = new Style({ stroke, image: new CircleStyle({ radius: 4, fill: new Fill({ color: COLOUR }) }) });
  map.addLayer(new VectorLayer({ source, style, zIndex: 20 }));
  const draw = new Draw({ source, type: "LineString", style });
  const input = make("input", { type: "number", min: 0, step: 0.01 });
  const option = make("code");
  const label = make("label", {}, "its true length, m ", input);
  const element = make("div", { className: "counts", hidden: true }, label, option);
  let length = 0;
  const show = () => {
    const right = (resolution * Number(input.value)) / length;
    option.textContent = right > 0 && Number.isFinite(right) ? `geoaim place … --frame-resolution ${right.toPrecision(4)}` : "";
  };
  input.addEventListener("input", show);
  draw.on("drawstart", ({ feature }) => {
    source.clear();
    feature.getGeometry().on("change", ({ target }) => {
      length = target.getLength();
      report(length);
      show();
    });
  });
  const toggle = (on) => {
    source.clear();
    element.hidden = !on || resolution === null;
    if (on) map.addInteraction(draw);
    else map.removeInteraction(draw);
  };
  return { toggle, element };
}
