/** The viewer of maps, tracks and what happens on them. */
import ScaleLine from "ol/control/ScaleLine.js";
import { defaults as defaultInteractions } from "ol/interaction/defaults.js";
import Map from "ol/Map.js";
import { describeAgent, listFacts } from "./agent_info.js";
import { AgentsLayer, FUTURE_COLOUR } from "./agents_layer.js";
import { describePoint } from "./coordinates.js";
import { addCounting, findCrossings } from "./counting.js";
import { make, makeCheckbox, makeLegend } from "./dom.js";
import { addShortcuts } from "./keys.js";
import { readLink, writeLink } from "./link.js";
import { addMeasure } from "./measure.js";
import { makeMapView } from "./map_view.js";
import { addRasterMove } from "./move_raster.js";
import { makeRasterLayer, placeRaster } from "./rasters.js";
import { addSwipe } from "./swipe.js";
import { listMarkKinds, Timeline } from "./timeline.js";
import { readJson } from "./transport.js";
import { findAgent, findStep, getPose, readTracks } from "./tracks.js";
import { makeShapesLayer } from "./vectors.js";
import { VideoBeside } from "./video.js";

const PICK_MARGIN_PX = 8;
const FIT_PADDING_PX = 30;
const MARK_TIME_S = 1e-3; // marks of files are rounded
const MARK_EXTENT_M = 60; // what is shown around the agent of a mark
const HOVER_PX = 14; // between the pointer and what it says
const KEYS = {
  Space: "play or pause",
  ", .": "one step back or on",
  "n p": "select the next or previous agent",
  m: "go to the next mark",
  f: "follow the selected agent",
  Esc: "select nothing",
  "arrows + −": "move and zoom the map, once it has the focus",
};
const AGENT_VIEW_PERIOD_MS = 200; // so that drawing them leaves the page smooth

/** Show a description (of `kind` "view") in an element; returns what tests and pages drive. */
export async function showView(element, description, transport, { link = false, keys = element } = {}) {
  const wanted = link ? location.hash : ""; // before the first picture writes its own
  const view = makeMapView(description.extent);
  const mapElement = make("div", { className: "map", tabIndex: 0, role: "application", ariaLabel: "map: arrow keys move it, + and − zoom" });
  const status = make("div", { className: "status" });
  const panel = make("details", { className: "panel", open: true }, make("summary", {}, "Layers"));
  const [mapLayers, traffic, tools] = ["map", "traffic", "tools"].map((name) => make("fieldset", {}, make("legend", {}, name)));
  panel.append(mapLayers, traffic, tools, makeKeysHelp());
  const hover = make("div", { className: "hover", hidden: true });
  const beside = description.video && transport.address ? new VideoBeside(description.video, transport.address("video")) : null;
  const agentView = make("img", { className: "agent-view", hidden: true, alt: "the view of the selected agent" });
  const selection = make("div", { className: "selection", hidden: true });
  element.replaceChildren(
    make(
      "div",
      { className: "sides" },
      make("div", { className: "stage" }, mapElement, panel, make("div", { className: "inset" }, selection, agentView), status, hover),
      ...(beside ? [beside.element] : []),
    ),
  );
  const map = new Map({
    target: mapElement,
    view,
    controls: [new ScaleLine({ minWidth: 90 })],
    interactions: defaultInteractions({ altShiftDragRotate: true, pinchRotate: true }),
  });
  const hidden = new Set(["trails"]);
  const { futures } = description.moving;
  const state = { time: futures?.start ?? 0, selected: null, follow: false, colouring: "type", shown: (name) => !hidden.has(name), ...description.moving };
  const agentsLayer = new AgentsLayer(state);
  const app = { map, view, state, agentsLayer, timeline: null, layers: {}, beside, findCrossings };

  const toggles = {};
  const addToggle = (name, layer, visible, { label = name, swatch = null, legend = null, group = mapLayers } = {}) => {
    const change = (on) => {
      toggles[name].firstChild.checked = on;
      if (on) hidden.delete(name);
      else hidden.add(name);
      layer?.setVisible(on);
      if (legend) legend.hidden = !on;
      agentsLayer.changed();
      save();
    };
    toggles[name] = makeCheckbox(label, visible, change, swatch);
    app.layers[name] = change;
    if (visible) hidden.delete(name);
    else hidden.add(name);
    group.append(toggles[name], ...(legend ? [legend] : []));
  };
  const toolSet = {}; // by name; a click on the map is for the one that is on
  const addTool = (name, label, change) => {
    const box = makeCheckbox(label, false, (on) => {
      for (const other of Object.values(toolSet)) if (on && other !== tool && other.on) other.input.click();
      tool.on = on;
      change(on);
    });
    const tool = { on: false, input: box.firstChild };
    toolSet[name] = tool;
    tools.append(box);
    return box;
  };
  const isToolOn = () => Object.values(toolSet).some((tool) => tool.on);
  let move = () => {}; // adds the tool that moves the lowest raster
  for (const raster of description.rasters) {
    const layer = makeRasterLayer(raster, transport, view.getProjection());
    map.addLayer(layer);
    const legend = raster.legend ? makeLegend(raster.legend) : null;
    if (legend) legend.hidden = !raster.visible;
    addToggle(raster.name, layer, raster.visible, { swatch: raster.colour, legend });
    if (raster.swipe) {
      mapLayers.append(makeCheckbox("swipe between the two", false, addSwipe(layer, map)));
    }
    if (raster === description.rasters[0]) {
      const text = make("small", { className: "moved", hidden: true });
      const place = (shift) => placeRaster(layer, raster, transport, view.getProjection(), shift);
      const toggle = addRasterMove(layer, map, place, (shift) => {
        text.textContent = `geoaim align --shift ${shift.map((metres) => metres.toFixed(2)).join(",")}`;
      });
      const change = (on) => {
        text.hidden = !on && text.textContent.endsWith(" 0.00,0.00");
        toggle(on);
      };
      move = () => {
        addTool("move", `move ${raster.name} by hand`, change).title = "drag it, or press arrow keys; geoaim align --shift moves the file as far";
        tools.append(text);
      };
    }
  }
  for (const shapes of description.shapes) {
    const layer = makeShapesLayer(shapes);
    map.addLayer(layer);
    addToggle(shapes.name, layer, shapes.visible, { swatch: shapes.colour });
  }
  map.addLayer(agentsLayer);
  if (state.lights) addToggle("lights", null, true, { group: traffic });
  if (futures) {
    const label = `futures, ${futures.start} to ${futures.end} s`;
    addToggle("futures", null, true, { label, swatch: FUTURE_COLOUR, group: traffic });
  }
  const resolution = description.lonlat ? null : 1 / Math.hypot(...description.pixels_from_world[0].slice(0, 2));
  const measure = addMeasure(map, (length) => (status.textContent = `${length.toFixed(2)} m`), resolution);
  addTool("measure", "measure", measure.toggle);
  tools.append(measure.element);
  if (description.moving.tracks) {
    for (const [shape, label] of [["line", "count over a line"], ["zone", "count in a zone"]]) {
      const counting = addCounting(map, shape, () => state.tracks);
      addTool(shape, label, counting.toggle);
      tools.append(counting.element);
    }
  }
  move();
  if (beside) {
    const showVideo = (on) => {
      beside.element.hidden = !on;
      beside.show(state.time, false, 1);
      map.updateSize();
    };
    tools.append(makeCheckbox(`video ${description.video}`, true, showVideo));
  }

  let loadingView = null;
  let lastAsked = -Infinity;
  const showAgentView = async () => {
    const wanted = state.selected && `${state.selected.id}/${findStep(state.tracks.times, state.time)}`;
    agentView.hidden = !wanted || !description.agent_views;
    if (agentView.hidden || loadingView || agentView.dataset.shown === wanted) return;
    const wait = lastAsked + AGENT_VIEW_PERIOD_MS - performance.now();
    loadingView = wanted;
    if (wait > 0) await new Promise((resolve) => setTimeout(resolve, wait));
    lastAsked = performance.now();
    try {
      const bytes = await transport.read(`agent_views/${encodeURIComponent(state.selected.id)}/${wanted.split("/").pop()}`);
      URL.revokeObjectURL(agentView.src);
      agentView.src = URL.createObjectURL(new Blob([bytes]));
      agentView.style.visibility = "visible";
    } catch {
      agentView.style.visibility = "hidden"; // the agent is absent then
    }
    agentView.dataset.shown = wanted;
    loadingView = null;
    if (state.selected) showAgentView();
  };
  const followAgent = () => {
    const pose = state.follow && state.selected && getPose(state.tracks, state.selected, state.time);
    if (!pose) return;
    view.setCenter(pose.slice(0, 2));
    view.setRotation(pose[2] - Math.PI / 2); // heading up
  };
  let facts = [];
  const showFacts = () => {
    if (!state.selected) return;
    listFacts(state.tracks, state.selected, state.time).forEach(([, value], index) => (facts[index].textContent = value));
  };
  const seek = (time) => {
    state.time = time;
    beside?.show(time, app.timeline?.playing ?? false, app.timeline?.speed ?? 1);
    hover.hidden = true; // the agent has gone on
    showFacts();
    followAgent();
    agentsLayer.changed();
    showAgentView();
    save();
  };
  const select = (agent) => {
    state.selected = agent;
    selection.hidden = !agent;
    if (agent) {
      const follow = makeCheckbox("follow, heading up (f)", state.follow, app.follow);
      const close = make("button", { type: "button", title: "select nothing (Esc)", ariaLabel: "select nothing" }, "✕");
      close.addEventListener("click", () => select(null));
      const rows = listFacts(state.tracks, agent, state.time).map(([name, value]) => [make("dt", {}, name), make("dd", {}, value)]);
      facts = rows.map(([, value]) => value);
      const title = make("header", {}, make("b", {}, `${agent.type} ${agent.id}`), close);
      selection.replaceChildren(title, make("dl", {}, ...rows.flat()), follow);
    }
    app.follow(Boolean(agent) && state.follow);
  };
  app.follow = (on) => {
    if (state.follow && !on) view.setRotation(0); // a map that was turned by hand stays as it is
    state.follow = on;
    const box = selection.querySelector("input");
    if (box) box.checked = on;
    seek(state.time);
  };
  app.select = (id) => select(state.tracks?.agents.find((agent) => agent.id === id) ?? null);

  const showMark = ({ time, agent }) => {
    app.timeline.set(time);
    app.select(agent);
    const pose = getPose(state.tracks, state.selected, time);
    if (!pose) return;
    view.setCenter(pose.slice(0, 2));
    view.setResolution(Math.min(view.getResolution(), MARK_EXTENT_M / Math.min(...map.getSize())));
  };

  let pending = null;
  const save = () => {
    if (!link || pending) return;
    pending = setTimeout(() => ((pending = null), writeLink(app, hidden)), 300);
  };
  map.on("moveend", save);
  const findAt = (coordinate) => findAgent(state.tracks, state.time, coordinate, PICK_MARGIN_PX * view.getResolution());
  map.on("pointermove", ({ coordinate, pixel: [x, y], dragging }) => {
    if (!toolSet.measure.on) status.textContent = describePoint(description, coordinate);
    const agent = !dragging && !isToolOn() && state.tracks && state.shown("tracks") && findAt(coordinate);
    hover.hidden = !agent;
    if (!agent) return;
    hover.textContent = describeAgent(state.tracks, agent, state.time);
    const [width, height] = map.getSize();
    const left = Math.min(x + HOVER_PX, width - hover.offsetWidth - HOVER_PX);
    const top = y + HOVER_PX + hover.offsetHeight > height ? y - HOVER_PX - hover.offsetHeight : y + HOVER_PX;
    hover.style.cssText = `left:${left}px;top:${top}px`;
  });
  mapElement.addEventListener("pointerleave", () => (hover.hidden = true));
  map.on("click", ({ coordinate }) => {
    if (isToolOn() || !state.tracks) return;
    select(findAt(coordinate));
  });
  const selectNext = (change) => {
    const present = state.tracks?.agents.filter((agent) => getPose(state.tracks, agent, state.time)) ?? [];
    if (!present.length) return;
    const index = present.indexOf(state.selected);
    select(present[index < 0 && change < 0 ? present.length - 1 : (index + change + present.length) % present.length]);
  };
  const step = (change) => {
    const { times } = state.tracks;
    app.timeline.toggle(false);
    app.timeline.set(times[Math.min(Math.max(findStep(times, state.time) + change, 0), times.length - 1)]);
  };
  const goToMark = () => {
    const marks = app.marks ?? [];
    if (marks.length) showMark(marks.find(({ time }) => time > state.time + MARK_TIME_S) ?? marks[0]);
  };
  const actions = {
    " ": () => app.timeline?.toggle(),
    ",": () => app.timeline && step(-1),
    ".": () => app.timeline && step(1),
    n: () => selectNext(1),
    p: () => selectNext(-1),
    m: goToMark,
    f: () => app.follow(!state.follow),
    Escape: () => select(null),
  };
  addShortcuts(keys, element, ({ key, ctrlKey, metaKey, altKey }) => {
    const act = ctrlKey || metaKey || altKey ? null : actions[key];
    act?.();
    return Boolean(act);
  });

  const padding = Array(4).fill(FIT_PADDING_PX);
  map.updateSize();
  view.fit(description.extent, { padding });
  map.once("rendercomplete", () => performance.mark("geoaim-painted"));
  if (state.tracks) {
    state.tracks = null;
    state.tracks = await readTracks(description.moving.tracks, transport);
    const { times, colours } = state.tracks;
    app.timeline = new Timeline(times[0], times[times.length - 1], seek);
    if (futures) app.timeline.set(futures.start);
    element.append(app.timeline.element);
    map.updateSize();
    if (beside) app.timeline.clock = () => beside.time;
    addToggle("tracks", null, true, { group: traffic });
    addToggle("trails", null, false, { group: traffic });
    const legend = make("div", {});
    app.colour = (by) => {
      state.colouring = colourBy.value = by;
      const types = Object.entries(colours).map(([type, colour]) => makeKey(colour, type));
      legend.replaceChildren(...(by === "speed" ? [makeLegend(state.tracks.speeds)] : types));
      agentsLayer.changed();
      save();
    };
    const colourBy = make("select", {}, ...["type", "speed"].map((name) => make("option", { value: name }, name)));
    colourBy.addEventListener("change", () => app.colour(colourBy.value));
    traffic.append(make("label", {}, "colour by", colourBy), legend);
    app.colour("type");
  }
  if (link) readLink(app, wanted);
  if (description.marks && app.timeline) {
    readJson(transport, description.marks).then((marks) => {
      app.marks = marks;
      app.timeline.showMarks(marks, showMark);
      for (const [kind, colour] of listMarkKinds(marks)) {
        const count = marks.filter((mark) => mark.kind === kind).length;
        traffic.append(makeKey(colour, `${kind} (${count})`));
      }
    });
  }
  return app;
}

/** A colour and what it stands for. */
function makeKey(colour, text) {
  return make("small", {}, make("i", { className: "swatch", style: `background:${colour}` }), text);
}

function makeKeysHelp() {
  const rows = Object.entries(KEYS).flatMap(([keys, meaning]) => [make("dt", {}, keys), make("dd", {}, meaning)]);
  return make("details", {}, make("summary", {}, "Keys"), make("dl", {}, ...rows));
}
