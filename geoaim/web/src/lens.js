/** A lens: the pixels around the pointer, magnified. */
import { make } from "./dom.js";

const MAGNIFICATION = 4;
const LENS_PX = 150;
const CROSS_COLOUR = "#00c2ff";

/** Add a lens to a map; it follows the pointer, and what is drawn beneath it. */
export function addLens(map) {
  const target = map.getTargetElement();
  const lens = make("canvas", { className: "lens", width: LENS_PX, height: LENS_PX, hidden: true });
  let pointer = null;
  const draw = () => {
    lens.hidden = pointer === null;
    if (!lens.hidden) drawLens(lens.getContext("2d"), target, pointer);
  };
  target.append(lens);
  target.addEventListener("pointerleave", () => ((pointer = null), draw()));
  map.on("pointermove", ({ pixel, dragging }) => ((pointer = dragging ? null : pixel), draw()));
  map.on("postrender", draw);
}

function drawLens(context, target, [x, y]) {
  const middle = LENS_PX / 2;
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.clearRect(0, 0, LENS_PX, LENS_PX);
  context.imageSmoothingEnabled = false;
  for (const canvas of target.querySelectorAll(".ol-layer canvas")) {
    context.setTransform(MAGNIFICATION, 0, 0, MAGNIFICATION, middle - MAGNIFICATION * x, middle - MAGNIFICATION * y);
    context.transform(...readTransform(canvas));
    context.drawImage(canvas, 0, 0);
  }
  context.setTransform(1, 0, 0, 1, 0, 0);
  context.strokeStyle = CROSS_COLOUR;
  context.strokeRect(middle - 0.5, 0, 0, LENS_PX);
  context.strokeRect(0, middle - 0.5, LENS_PX, 0);
}

/** From a canvas's pixels to those of the page: OpenLayers turns it by a style. */
function readTransform(canvas) {
  const numbers = canvas.style.transform.match(/^matrix\((.*)\)$/)?.[1];
  if (numbers) return numbers.split(",").map(Number);
  const scale = canvas.clientWidth / canvas.width;
  return [scale, 0, 0, scale, 0, 0];
}
