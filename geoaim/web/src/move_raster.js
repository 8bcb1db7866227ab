/** A raster that is moved by hand, to lie under tracks: by dragging it, or by arrow keys. */
import Pointer from "ol/interaction/Pointer.js";
import { getRenderPixel } from "ol/render.js";

const KEY_STEP_M = 0.1;
const KEYS = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] };

/** Let a layer be moved; `place(shift)` puts its tiles there, `report` gets metres east and north. */
export function addRasterMove(layer, map, place, report) {
  let shift = [0, 0]; // of the tiles
  let from = null; // where a drag began
  let drag = [0, 0]; // how far it has come; the picture is moved, its tiles follow at the end
  const add = (a, b) => [a[0] + b[0], a[1] + b[1]];
  const settle = (to) => {
    [shift, drag] = [to, [0, 0]];
    place(shift);
    report(shift);
  };
  const pointer = new Pointer({
    handleDownEvent: ({ coordinate }) => ((from = coordinate), true),
    handleDragEvent: ({ coordinate }) => {
      drag = [coordinate[0] - from[0], coordinate[1] - from[1]];
      report(add(shift, drag));
      map.render();
    },
    handleUpEvent: () => (settle(add(shift, drag)), false),
  });
  layer.on("prerender", (event) => {
    const pixels = [[0, 0], drag].map((point) => map.getPixelFromCoordinate(add(map.getView().getCenter(), point)));
    const [start, end] = pixels.map((pixel) => getRenderPixel(event, pixel));
    event.context.save();
    event.context.translate(end[0] - start[0], end[1] - start[1]);
  });
  layer.on("postrender", ({ context }) => context.restore());
  const press = (event) => {
    const direction = KEYS[event.key];
    if (!direction || event.target.matches("[role=slider], input[type=range]")) return;
    event.preventDefault();
    event.stopPropagation();
    settle(add(shift, direction.map((part) => KEY_STEP_M * part)));
  };
  return (on) => {
    const element = map.getTargetElement().ownerDocument;
    if (on) {
      map.addInteraction(pointer);
      element.addEventListener("keydown", press, true);
      report(shift);
    } else {
      map.removeInteraction(pointer);
      element.removeEventListener("keydown", press, true);
    }
  };
}
