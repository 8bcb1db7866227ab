/** The viewer of maps, tracks and what happens on them. */
import ScaleLine from "ol/control/ScaleLine.js";
import { defaults as defaultInteractions } from "ol/interaction/defaults.js";
import Map from "ol/Map.js";
import { AgentsLayer, FUTURE_COLOUR } from "./agents_layer.js";
import { describePoint } from "./coordinates.js";
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

const PICK_MARGIN_PX = 8;
const FIT_PADDING_PX = 30;
const MARK_EXTENT_M = 60; // what is shown around the agent of a mark
const AGENT_VIEW_PERIOD_MS = 200; // so that drawing them leaves the page smooth

/** Show a description (of `kind` "view") in an element; returns what tests and pages drive. */
export async function showView(element, description, transport, { link = false, keys = element } = {}) {
  const view = makeMapView(description.extent);
  const mapElement = make("div", { className: "map" });
  const status = make("div", { className: "status" });
  const panel = make("details", { className: "panel", open: true }, make("summary", {}, "Layers"));
  const agentView = make("img", { className: "agent-view", hidden: true, alt: "the view of the selected agent" });
  const selection = make("div", { className: "selection", hidden: true });
  element.replaceChildren(
    make("div", { className: "stage" }, mapElement, panel, make("div", { className: "inset" }, selection, agentView), status),
  );
  const map = new Map({
    target: mapElement,
    view,
    controls: [new ScaleLine({ minWidth: 90 })],
    interactions: defaultInteractions({ altShiftDragRotate: true, pinchRotate: true }),
  });
  const hidden = new Set();
  const { futures } = description.moving;
  const state = { time: futures?.start ?? 0, selected: null, follow: false, shown: (name) => !hidden.has(name), ...description.moving };
  const agentsLayer = new AgentsLayer(state);
  const app = { map, view, state, agentsLayer, timeline: null, layers: {} };

  const toggles = {};
  const addToggle = (name, layer, visible, { label = name, swatch = null, legend = null } = {}) => {
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
    if (!visible) hidden.add(name);
    panel.append(toggles[name], ...(legend ? [legend] : []));
  };
  let moving = false;
  const move = []; // what moves the lowest raster
  for (const raster of description.rasters) {
    const layer = makeRasterLayer(raster, transport, view.getProjection());
    map.addLayer(layer);
    const legend = raster.legend ? makeLegend(raster.legend) : null;
    if (legend) legend.hidden = !raster.visible;
    addToggle(raster.name, layer, raster.visible, { swatch: raster.colour, legend });
    if (raster.swipe) {
      panel.append(makeCheckbox("swipe between the two", false, addSwipe(layer, map)));
    }
    if (!move.length) {
      const text = make("small", { className: "moved", hidden: true });
      const place = (shift) => placeRaster(layer, raster, transport, view.getProjection(), shift);
      const toggle = addRasterMove(layer, map, place, (shift) => {
        text.textContent = `geoaim align --shift ${shift.map((metres) => metres.toFixed(2)).join(",")}`;
      });
      const change = (on) => {
        moving = on;
        text.hidden = !on && text.textContent.endsWith(" 0.00,0.00");
        toggle(on);
      };
      const box = makeCheckbox(`move ${raster.name} by hand`, false, change);
      box.title = "drag it, or press arrow keys; geoaim align --shift moves the file as far";
      move.push(box, text);
    }
  }
  for (const shapes of description.shapes) {
    const layer = makeShapesLayer(shapes);
    map.addLayer(layer);
    addToggle(shapes.name, layer, shapes.visible, { swatch: shapes.colour });
  }
  map.addLayer(agentsLayer);
  if (state.lights) addToggle("lights", null, true);
  if (futures) {
    const label = `futures, ${futures.start} to ${futures.end} s`;
    addToggle("futures", null, true, { label, swatch: FUTURE_COLOUR });
  }
  const setMeasure = addMeasure(map, (length) => (status.textContent = `${length.toFixed(2)} m`));
  let measuring = false;
  panel.append(makeCheckbox("measure", false, (on) => setMeasure((measuring = on))), ...move);

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
  const seek = (time) => {
    state.time = time;
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
      selection.replaceChildren(make("b", {}, `${agent.type} ${agent.id}`), follow);
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
  map.on("pointermove", ({ coordinate }) => {
    if (!measuring) status.textContent = describePoint(description, coordinate);
  });
  map.on("click", ({ coordinate }) => {
    if (measuring || moving || !state.tracks) return;
    select(findAgent(state.tracks, state.time, coordinate, PICK_MARGIN_PX * view.getResolution()));
  });
  const actions = { " ": () => app.timeline?.toggle(), f: () => app.follow(!state.follow), Escape: () => select(null) };
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
    addToggle("tracks", null, true);
    for (const [type, colour] of Object.entries(colours)) {
      const swatch = make("i", { className: "swatch", style: `background:${colour}` });
      panel.append(make("small", {}, swatch, type));
    }
  }
  if (link) readLink(app);
  if (description.marks && app.timeline) {
    readJson(transport, description.marks).then((marks) => {
      app.marks = marks;
      app.timeline.showMarks(marks, showMark);
      for (const [kind, colour] of listMarkKinds(marks)) {
        const count = marks.filter((mark) => mark.kind === kind).length;
        panel.append(make("small", {}, make("i", { className: "swatch", style: `background:${colour}` }), `${kind} (${count})`));
      }
    });
  }
  return app;
}
