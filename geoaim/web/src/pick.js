/** Picking of control points: pixels of a frame, and their places on imagery or typed. */
import { formatMetres, make, makeCheckbox, saveText } from "./dom.js";
import { addShortcuts } from "./keys.js";
import { invert, linearize, project } from "./homography.js";
import { PixelMap } from "./pixel_map.js";

const EXPORTS = { csv: "points.csv", txt: "gcp_list.txt", points: "frame.points" };
const SNAP_SCREEN_PX = 4;
const SEARCH_PERIOD_MS = 300; // between two questions how far a search for pairs is
const ELLIPSE_STEPS = 40;
// two numbers, as map services copy a place; both with a point, since a comma may be a decimal sign
const PASTED = /^\s*(-?\d+\.\d+)[\s,;]+(-?\d+\.\d+)\s*$/;
const format = (value, digits) => (value === null || value === undefined ? "" : value.toFixed(digits));

/** The points of an ellipse {u, v, axes}: axes are two vectors in pixels. */
function makeRing({ u, v, axes_px: axes }) {
  return Array.from({ length: ELLIPSE_STEPS + 1 }, (_, index) => {
    const angle = (2 * Math.PI * index) / ELLIPSE_STEPS;
    const [cos, sin] = [Math.cos(angle), Math.sin(angle)];
    return [u + cos * axes[0][0] + sin * axes[1][0], v + cos * axes[0][1] + sin * axes[1][1]];
  });
}

/** Show a description (of `kind` "pick") in an element; returns what tests drive. */
export async function showPicking(element, description, transport, { keys = element } = {}) {
  const makeSide = (name) => make("div", { className: "map pickable", tabIndex: 0, role: "application", ariaLabel: `${name}: arrow keys move it, + and − zoom` });
  const [frameElement, imageryElement] = [makeSide("frame"), makeSide("imagery")];
  const table = make("table", { className: "points" });
  const message = make("div", { className: "message", role: "status", tabIndex: 0 });
  const bar = make("div", { className: "bar" });
  const sides = make("div", { className: "sides" }, make("div", { className: "stage" }, frameElement));
  if (description.imagery) sides.append(make("div", { className: "stage" }, imageryElement));
  element.replaceChildren(bar, sides, message, make("div", { className: "scroll" }, table));

  const app = { state: null, selected: null, frame: null, imagery: null, busy: Promise.resolve() };
  let snapping = true;
  let opacity = 0;
  const ask = (action) => {
    app.busy = app.busy.then(async () => {
      const reply = await transport.call(action);
      if (reply.error) message.textContent = reply.error;
      else if (reply.points) show(reply);
      return reply;
    });
    return app.busy;
  };
  const snap = async (side, [u, v]) => {
    if (!snapping) return { u, v };
    // the larger a picture is shown, the more exact a click is
    const radius = SNAP_SCREEN_PX * app[side].map.getView().getResolution();
    return (await ask({ action: "snap", side, u, v, radius })).snapped ?? { u, v };
  };
  // a click joins a point that lacks this side, the selected one first; else it begins a new point
  const place = async (side, pixel) => {
    const lacking = side === "imagery" ? (point) => point.x === null : (point) => point.u === null;
    const open = app.state.points.filter(lacking);
    const joined = open.find((point) => point.id === app.selected) ?? open.at(-1);
    const where = { side, ...(await snap(side, pixel)) };
    if (joined) return ask({ action: "move", id: joined.id, ...where });
    const reply = await ask({ action: "add", ...where });
    follow(side, [where.u, where.v]);
    return select(reply.added);
  };
  // the other picture shows the ground around a new point, where the points before it tell which
  const follow = (side, pixel) => {
    const matrix = app.state.imagery_from_frame;
    if (!matrix || !app.imagery) return;
    const [from, to, transform] =
      side === "frame" ? [app.frame, app.imagery, matrix] : [app.imagery, app.frame, invert(matrix)];
    to.follow(from, project(transform, pixel), linearize(transform, pixel));
  };
  const events = (side) => ({
    click: (pixel) => place(side, pixel),
    // a drag is not snapped: it may correct a wrong snap
    drag: (id, [u, v]) => ask({ action: "move", id, side, u, v }),
    accept: (candidate) => ask({ action: "accept", candidate }),
    select: (id) => select(id),
  });
  app.frame = new PixelMap(frameElement, description.frame, transport, events("frame"));
  if (description.imagery) {
    app.imagery = new PixelMap(imageryElement, description.imagery, transport, events("imagery"));
  }
  app.frame.map.once("rendercomplete", () => performance.mark("geoaim-painted"));

  const select = (id) => {
    app.selected = id;
    show(app.state);
  };
  const button = (label, title, act) => {
    const made = make("button", { title }, label);
    made.addEventListener("click", act);
    bar.append(made);
    return made;
  };
  const undo = button("Undo", "Ctrl+Z", () => ask({ action: "undo" }));
  const redo = button("Redo", "Ctrl+Shift+Z", () => ask({ action: "redo" }));
  if (app.imagery) {
    const propose = button("Propose pairs", "from the second point on; a click on a green one accepts it", async () => {
      propose.disabled = true;
      try {
        await searchPairs();
      } finally {
        propose.disabled = false;
        searching.hidden = true;
      }
    });
    const searching = make("label", { className: "searching", hidden: true }, make("progress"), make("span"));
    bar.append(searching);
    // the search goes on while points are picked
    const searchPairs = async () => {
      let { search } = await ask({ action: "propose" });
      while (search) {
        const [progress, text] = searching.children;
        Object.assign(progress, { max: search.total, value: search.done });
        text.textContent = `searching, ${Math.round(search.seconds)} s`;
        searching.hidden = false;
        await new Promise((resolve) => setTimeout(resolve, SEARCH_PERIOD_MS));
        ({ search } = await ask({ action: "proposed" }));
      }
    };
    const slider = make("input", { type: "range", min: 0, max: 1, step: 0.05, value: 0 });
    slider.addEventListener("input", () => setOpacity(Number(slider.value)));
    const turn = make("input", { type: "range", min: -180, max: 180, step: 5, value: 0 });
    turn.addEventListener("input", () => app.imagery.turn(Number(turn.value)));
    app.imagery.map.getView().on("change:rotation", () => (turn.value = app.imagery.getTurn()));
    bar.append(make("label", {}, "frame over imagery ", slider), make("label", {}, "turn imagery ", turn));
  }
  bar.append(makeCheckbox("snap clicks to corners", true, (on) => (snapping = on)));
  const accuracy = make("input", { type: "number", min: 0, step: "any", title: "one standard deviation of the coordinates" });
  accuracy.addEventListener("change", () => ask({ action: "accuracy", m: Number(accuracy.value) }));
  bar.append(make("label", {}, "points' accuracy, m ", accuracy));
  button("Fit", "show the whole pictures", () => [app.frame, app.imagery].forEach((map) => map?.fit()));
  bar.append(make("span", {}, "save as"));
  for (const [kind, name] of Object.entries(EXPORTS)) {
    button(name, `save the points as ${name}`, async () => {
      const { text } = await ask({ action: "export", format: kind });
      if (text === undefined) return;
      saveText(name, text);
    });
  }

  const setOpacity = async (value) => {
    const begins = value > 0 && opacity === 0;
    opacity = value;
    app.imagery.overlay.setOpacity(value);
    if (begins) await showOverlay();
  };
  const showOverlay = async () => {
    if (!app.imagery || opacity === 0) return;
    const reply = await transport.call({ action: "overlay" });
    if (reply.url) app.imagery.setOverlay(reply);
  };

  const describe = ({ points, candidates, disagreeing, feedback, notes, saved }) => {
    const other = app.imagery ? "then the same mark on the imagery" : "then type its coordinates into the table";
    const parts = points.length ? [] : [`Click a mark on the frame, ${other}.`];
    if (candidates.length) parts.push(`${candidates.length} proposed pairs, green: a click accepts one.`);
    const doubted = disagreeing.map(({ name, distance_m: distance }) => `${name} by ${format(distance, 1)} m`);
    if (doubted.length) parts.push(`The proposed pairs disagree with ${doubted.join(", ")}: look which are right.`);
    const { georeference, next_point: next } = feedback;
    if (feedback.problem) parts.push(feedback.problem.text);
    else if (feedback.missing) parts.push(`${feedback.missing} more complete points are needed.`);
    if (georeference) {
      const kind = georeference.preliminary ? "Preliminary" : "Fitted";
      const { middle_m: middle, worst_corner: corner, worst_corner_m: worst } = georeference.uncertainty;
      parts.push(`${kind} ${georeference.model}; uncertainty (95 %): ${formatMetres(middle)} in the middle, ${formatMetres(worst)} at the ${corner}.`);
    }
    if (next) parts.push(`A point at the dashed circle lowers the largest uncertainty from ${formatMetres(next.largest_m)} to ${formatMetres(next.largest_with_point_m)}.`);
    parts.push(...feedback.warnings.map((warning) => warning.text), ...(notes ?? []));
    if (saved) parts.push(`Saved in ${saved}.`);
    return parts.join(" ");
  };

  const edit = (ariaLabel, value, change) => {
    const input = make("input", { ariaLabel, value, size: 12 });
    input.addEventListener("change", () => change(input.value, input));
    return input;
  };
  const makeRow = (point, residual, kind) => {
    const lonlat = app.state.crs === "EPSG:4326";
    const typed = (key) => async (text, input) => {
      const [first, second] = (text.match(PASTED) ?? []).slice(1).map(Number);
      if (second !== undefined) {
        const [x, y] = lonlat ? [second, first] : [first, second];
        const { error } = await ask({ action: "move", id: point.id, x, y });
        const read = lonlat ? `latitude ${y}, longitude ${x}` : `x ${x}, y ${y}`;
        if (!error) message.textContent = `Read as ${read}. ${message.textContent}`;
        return;
      }
      const unreadable = !text.trim() || !Number.isFinite(Number(text));
      input.classList.toggle("wrong", unreadable);
      if (unreadable) {
        message.textContent = `"${text}" is not saved: a number such as 36.3035 is needed.`;
        return;
      }
      const numbers = { x: point.x, y: point.y, [key]: Number(text) };
      app.typed = { ...(app.typed?.id === point.id ? app.typed : {}), id: point.id, [key]: Number(text) };
      const { x = numbers.x, y = numbers.y } = app.typed;
      if (Number.isFinite(x) && Number.isFinite(y) && x !== null && y !== null) ask({ action: "move", id: point.id, x, y });
    };
    const remove = make("button", { title: `delete ${point.name}`, ariaLabel: `delete ${point.name}` }, "✕");
    remove.addEventListener("click", () => ask({ action: "delete", id: point.id }));
    const digits = lonlat ? 8 : 3;
    const cells = [
      edit(`name of ${point.name}`, point.name, (name) => ask({ action: "rename", id: point.id, name })),
      format(point.u, 2),
      format(point.v, 2),
      edit(`${lonlat ? "longitude" : "x"} of ${point.name}`, format(point.x, digits), typed("x")),
      edit(`${lonlat ? "latitude" : "y"} of ${point.name}`, format(point.y, digits), typed("y")),
      format(residual?.distance_m, 3),
      format(residual && Math.hypot(...residual.residual_px), 2),
      format(residual?.leave_one_out_m, 3),
      remove,
    ];
    const row = make("tr", {}, ...cells.map((cell) => make("td", {}, cell)));
    row.classList.toggle("selected", point.id === app.selected);
    row.classList.toggle("wrong", kind === "wrong");
    row.addEventListener("click", (event) => {
      if (!event.target.matches("input, button")) select(point.id);
    });
    return row;
  };

  function show(state) {
    app.state = state;
    const { points, candidates, feedback } = state;
    if (!points.some((point) => point.id === app.selected)) app.selected = null;
    const residuals = new Map(feedback.residuals.map((residual) => [residual.name, residual]));
    const doubted = new Set(state.disagreeing.map(({ name }) => name));
    const kindOf = (point) => {
      if (point.u === null || point.x === null) return "incomplete";
      if (doubted.has(point.name)) return "wrong";
      return residuals.get(point.name)?.used === false ? "wrong" : "used";
    };
    const mark = (u, v) => (point) => ({
      pixel: [point[u], point[v]],
      ...{ kind: kindOf(point), name: point.name, id: point.id, selected: point.id === app.selected },
    });
    const proposed = (u, v) =>
      candidates.map((pair, candidate) => ({ pixel: [pair[u], pair[v]], kind: "candidate", name: String(candidate + 1), candidate }));
    const next = feedback.next_point ? [{ pixel: [feedback.next_point.u, feedback.next_point.v], kind: "next" }] : [];
    const onFrame = points.filter((point) => point.u !== null).map(mark("u", "v"));
    app.frame.show([...next, ...proposed("u", "v"), ...onFrame], feedback.places.filter((x) => x.axes_px).map(makeRing));
    const known = points.filter((point) => point.image_u !== undefined && point.image_u !== null);
    const matrix = state.imagery_from_frame;
    const expected = points.filter((point) => matrix && point.u !== null && point.x === null);
    const rings = expected.map(({ u, v }) => ({ pixel: project(matrix, [u, v]), kind: "next" }));
    app.imagery?.show([...rings, ...proposed("image_u", "image_v"), ...known.map(mark("image_u", "image_v"))]);
    const [x, y] = state.crs === "EPSG:4326" ? ["lon", "lat"] : ["x, m", "y, m"];
    const titles = ["name", "u", "v", x, y, "residual, m", "px", "leave-one-out, m", ""];
    const head = make("tr", {}, ...titles.map((title) => make(title ? "th" : "td", {}, title)));
    table.replaceChildren(head, ...points.map((point) => makeRow(point, residuals.get(point.name), kindOf(point))));
    accuracy.value = Number(state.accuracy.toPrecision(3));
    undo.disabled = !state.can_undo;
    redo.disabled = !state.can_redo;
    message.textContent = describe(state);
    showOverlay();
  }

  addShortcuts(keys, element, (event) => {
    const control = event.ctrlKey || event.metaKey;
    if (control && event.key.toLowerCase() === "z") ask({ action: event.shiftKey ? "redo" : "undo" });
    else if (event.key === "Delete" && app.selected) ask({ action: "delete", id: app.selected });
    else if (event.key === "Escape") select(null);
    else return false;
    return true;
  });
  app.ask = ask;
  await ask({ action: "state" });
  return app;
}
