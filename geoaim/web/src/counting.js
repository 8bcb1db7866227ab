/** Counts of the agents that drive over a line, or are in a zone, that is drawn on the map. */
import Draw from "ol/interaction/Draw.js";
import VectorLayer from "ol/layer/Vector.js";
import VectorSource from "ol/source/Vector.js";
import { Fill, Stroke, Style, Text } from "ol/style.js";
import Point from "ol/geom/Point.js";
import { make, saveText } from "./dom.js";
import { isPresent } from "./tracks.js";

const COLOUR = "#ffe14d";
const SIDE_PX = 18; // of the letters of the two sides, from the line

/**
 * Find the agents that cross the line from a to b: {time, agent, forward, x, y, speed}, by time.
 *
 * The middle of an agent crosses. Forward is from the left of the line to its right. One that comes
 * back before it was half its length away, as one that waits on the line, has not crossed.
 */
export function findCrossings({ times, agents, origin }, [ax, ay], [bx, by]) {
  const length = Math.hypot(bx - ax, by - ay) || 1;
  const [ex, ey] = [(bx - ax) / length, (by - ay) / length];
  const found = [];
  for (const agent of agents) {
    const { states, first, steps } = agent;
    const own = [];
    let last = null;
    const before = []; // how far it was away before each crossing
    let farthest = Infinity; // from the line, since the last crossing
    for (let step = 0; step < steps; step++) {
      if (!isPresent(agent, step)) continue;
      const [x, y, , speed] = states.subarray(4 * step, 4 * step + 4);
      const [east, north] = [x + origin[0] - ax, y + origin[1] - ay];
      const now = { along: east * ex + north * ey, left: north * ex - east * ey, time: times[first + step], speed };
      if (last && last.left > 0 !== now.left > 0) {
        const share = last.left / (last.left - now.left);
        const mix = (key) => last[key] + share * (now[key] - last[key]);
        const along = mix("along");
        if (along >= 0 && along <= length) {
          const place = { x: ax + along * ex, y: ay + along * ey };
          if (farthest < agent.length / 2 && own.length) {
            own.pop();
            farthest = before.pop();
          } else {
            own.push({ time: mix("time"), agent, forward: last.left > 0, speed: mix("speed"), ...place });
            before.push(farthest);
            farthest = 0;
          }
        }
      }
      farthest = Math.max(farthest, Math.abs(now.left));
      last = now;
    }
    found.push(...own);
  }
  return found.sort((one, other) => one.time - other.time);
}

/**
 * Find when agents were in a zone, a polygon: {agent, entered, left, speed, whole}, by time.
 *
 * The middle of an agent counts. Not whole is who was there when first or last seen. Speeds are means.
 */
export function findVisits({ times, agents, origin }, polygon) {
  const found = [];
  for (const agent of agents) {
    let visit = null;
    for (let step = 0; step < agent.steps; step++) {
      const [x, y, , speed] = agent.states.subarray(4 * step, 4 * step + 4);
      const present = isPresent(agent, step);
      const time = times[agent.first + step];
      if (present && polygon.intersectsCoordinate([x + origin[0], y + origin[1]])) {
        if (!visit) {
          visit = { agent, entered: time, speeds: [], whole: step > 0 && isPresent(agent, step - 1) };
          found.push(visit);
        }
        visit.left = time;
        visit.speeds.push(speed);
        if (step === agent.steps - 1) visit.whole = false;
      } else if (visit) {
        if (!present) visit.whole = false;
        visit = null;
      }
    }
  }
  const mean = (values) => values.reduce((sum, value) => sum + value, 0) / values.length;
  const visits = found.map(({ speeds, ...visit }) => ({ ...visit, speed: mean(speeds) }));
  return visits.sort((one, other) => one.entered - other.entered);
}

const quote = (text) => (/[",\r\n]/.test(text) ? `"${text.replaceAll('"', '""')}"` : text);
const format = (header, rows) => [header, ...rows.map((row) => row.join(","))].join("\n") + "\n";

/** Say how many agents there are, and of which types. */
function describeCount(title, agents) {
  const types = new Map();
  for (const { type } of agents) types.set(type, (types.get(type) ?? 0) + 1);
  const parts = [...types].map(([type, count]) => `${type} ${count}`).join(", ");
  return `${title}: ${agents.length}${parts && ` (${parts})`}`;
}

function countCrossings(tracks, geometry) {
  const crossings = findCrossings(tracks, ...geometry.getCoordinates());
  const driving = (forward) => crossings.filter((one) => one.forward === forward).map(({ agent }) => agent);
  const rows = crossings.map(({ time, agent, forward, x, y, speed }) => {
    const sides = forward ? ["A", "B"] : ["B", "A"];
    return [time.toFixed(3), quote(agent.id), quote(agent.type), ...sides, speed.toFixed(2), x.toFixed(2), y.toFixed(2)];
  });
  const lines = [describeCount("A → B", driving(true)), describeCount("B → A", driving(false))];
  return { lines, table: format("time,id,type,from,to,speed_m_s,x,y", rows) };
}

function countVisits(tracks, geometry) {
  const visits = findVisits(tracks, geometry);
  const agents = [...new Set(visits.map(({ agent }) => agent))];
  const stays = visits.filter(({ whole }) => whole).map(({ entered, left }) => left - entered).sort((a, b) => a - b);
  const rows = visits.map(({ agent, entered, left, whole, speed }) => {
    return [quote(agent.id), quote(agent.type), entered.toFixed(3), left.toFixed(3), whole, speed.toFixed(2)];
  });
  const lines = [describeCount("in the zone", agents)];
  if (stays.length) lines.push(`median stay ${stays[stays.length >> 1].toFixed(1)} s (${stays.length} seen from entry to exit)`);
  return { lines, table: format("id,type,entered,left,whole,mean_speed_m_s", rows) };
}

const SHAPES = {
  line: { type: "LineString", maxPoints: 2, prompt: "Draw a line: two clicks on the map.", file: "counts.csv", count: countCrossings },
  zone: { type: "Polygon", prompt: "Draw a zone: click its corners, and the first one again.", file: "visits.csv", count: countVisits },
};

/** Add a tool that counts over a "line" or in a "zone", for `getTracks()`; returns its `toggle(on)` and its element. */
export function addCounting(map, shape, getTracks) {
  const { type, maxPoints, prompt, file, count } = SHAPES[shape];
  const source = new VectorSource();
  map.addLayer(new VectorLayer({ source, style: makeStyles, zIndex: 20 }));
  const draw = new Draw({ source, type, maxPoints, style: makeStyles });
  const text = make("div", { role: "status" });
  const save = make("button", { type: "button" }, `save ${file}`);
  const element = make("div", { className: "counts", hidden: true }, text, save);
  let counted = null;
  const show = (geometry) => {
    counted = geometry && count(getTracks(), geometry);
    const lines = counted ? counted.lines : [prompt];
    text.replaceChildren(...lines.map((words) => make("div", {}, words)));
    save.hidden = !counted;
  };
  draw.on("drawstart", () => source.clear());
  draw.on("drawend", ({ feature }) => show(feature.getGeometry()));
  save.addEventListener("click", () => saveText(file, counted.table));
  const toggle = (on) => {
    source.clear();
    show(null);
    element.hidden = !on;
    if (on) map.addInteraction(draw);
    else map.removeInteraction(draw);
  };
  return { toggle, element };
}

/** The line, with the letters of its sides; the edge of a zone. */
function makeStyles(feature, resolution) {
  const line = new Style({ stroke: new Stroke({ color: COLOUR, width: 3 }) });
  const geometry = feature.getGeometry();
  if (geometry.getType() !== "LineString") return line;
  const [a, b] = [geometry.getFirstCoordinate(), geometry.getLastCoordinate()];
  const length = Math.hypot(b[0] - a[0], b[1] - a[1]);
  if (!length) return line;
  const letter = (name, side) => {
    const reach = (side * SIDE_PX * resolution) / length;
    const place = [(a[0] + b[0]) / 2 - reach * (b[1] - a[1]), (a[1] + b[1]) / 2 + reach * (b[0] - a[0])];
    const stroke = new Stroke({ color: "black", width: 4 });
    const text = new Text({ text: name, font: "bold 16px sans-serif", fill: new Fill({ color: COLOUR }), stroke });
    return new Style({ geometry: new Point(place), text });
  };
  return [line, letter("A", 1), letter("B", -1)];
}
