/** A line across the map that shows one raster on its left and another on its right. */
import { getRenderPixel } from "ol/render.js";
import { make } from "./dom.js";

const KEY_STEP = 0.02; // of the width, by an arrow key

/** Show `layer` right of a line only, as soon as it is switched on; returns `toggle(on)`. */
export function addSwipe(layer, map) {
  let share = 0.5; // of the width, left of the line
  let on = false;
  const handle = make("span", { title: "imagery on the left, map on the right" }, "◂ ▸");
  const line = make("div", { className: "swipe", hidden: true, tabIndex: 0 }, handle);
  line.setAttribute("role", "slider");
  line.setAttribute("aria-label", "swipe");
  map.getTargetElement().append(line);
  const move = (to) => {
    share = Math.min(Math.max(to, 0), 1);
    line.style.left = `${100 * share}%`;
    line.setAttribute("aria-valuenow", Math.round(100 * share));
    map.render();
  };
  line.addEventListener("pointerdown", (event) => {
    line.setPointerCapture(event.pointerId);
    event.stopPropagation(); // the map stays
  });
  line.addEventListener("pointermove", (event) => {
    if (!line.hasPointerCapture(event.pointerId)) return;
    const { left, width } = map.getTargetElement().getBoundingClientRect();
    move((event.clientX - left) / width);
  });
  line.addEventListener("keydown", ({ key }) => {
    if (key === "ArrowLeft") move(share - KEY_STEP);
    if (key === "ArrowRight") move(share + KEY_STEP);
  });
  clipRight(layer, map, () => (on ? share : null));
  move(share);
  return (wanted) => {
    on = wanted;
    line.hidden = !on;
    map.render();
  };
}

/** Draw a layer only right of a place (0 left, 1 right) of the map; `get` returns it or null. */
function clipRight(layer, map, get) {
  layer.on("prerender", ({ context, ...event }) => {
    const share = get();
    if (share === null) return;
    const [width, height] = map.getSize();
    const corners = [[width * share, 0], [width, 0], [width, height], [width * share, height]];
    context.save();
    context.beginPath();
    for (const corner of corners) context.lineTo(...getRenderPixel({ context, ...event }, corner));
    context.closePath();
    context.clip();
  });
  layer.on("postrender", ({ context }) => {
    if (get() !== null) context.restore();
  });
}
