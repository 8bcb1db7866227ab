/** A layer that draws what moves: agents, traffic lights and predicted futures. */
import Layer from "ol/layer/Layer.js";
import { findStep, getBox, getPose, getSpeed, isPresent } from "./tracks.js";

export const SELECTED_COLOUR = "#ff6a00";
const UNKNOWN_COLOUR = "#9a9a9a";
export const FUTURE_COLOUR = "rgba(255, 106, 0, 0.55)";
const LIGHT_WIDTH_M = 0.8;
const TRAIL_S = 5;
const LEAST_PX = 9; // length of agents that are seen from far
const SAME_TIME_S = 1e-3; // times of files are rounded to milliseconds

/** Draws a state: {tracks, lights, futures, time, selected, colouring, shown}; call `changed()` after a change. */
export class AgentsLayer extends Layer {
  constructor(state) {
    super({ zIndex: 10 });
    this.state = state;
    this.canvas = document.createElement("canvas");
    this.canvas.style.cssText = "position:absolute;inset:0;width:100%;height:100%";
    this.framesDrawn = 0;
  }

  render(frame) {
    const { canvas } = this;
    const [width, height] = frame.size.map((side) => Math.round(side * frame.pixelRatio));
    if (canvas.width !== width || canvas.height !== height) Object.assign(canvas, { width, height });
    const context = canvas.getContext("2d");
    context.setTransform(1, 0, 0, 1, 0, 0);
    context.clearRect(0, 0, width, height);
    // from here on in metres of the world
    context.setTransform(...frame.coordinateToPixelTransform.map((value) => value * frame.pixelRatio));
    const pixel = frame.viewState.resolution;
    const { lights, tracks, futures, shown } = this.state;
    if (lights && shown("lights")) this.drawLights(context, lights);
    if (futures && shown("futures") && this.isPredicted(futures)) this.drawFutures(context, futures, pixel);
    if (tracks && shown("tracks")) this.drawAgents(context, tracks, pixel);
    context.setTransform(1, 0, 0, 1, 0, 0); // OpenLayers draws the next layer into the same canvas
    this.framesDrawn++;
    return canvas;
  }

  drawLights(context, lights) {
    const step = findStep(lights.times, this.state.time);
    const known = this.state.time >= lights.times[0];
    context.lineWidth = LIGHT_WIDTH_M;
    lights.lines.forEach(([start, end], index) => {
      const light = known ? lights.states[step][index] : -1;
      context.strokeStyle = lights.colours[light] ?? UNKNOWN_COLOUR;
      context.beginPath();
      context.moveTo(...start);
      context.lineTo(...end);
      context.stroke();
    });
  }

  /** Whether futures say anything of the time shown: from their last observed step to their end. */
  isPredicted({ start, end }) {
    return this.state.time >= start - SAME_TIME_S && this.state.time <= end + SAME_TIME_S;
  }

  drawFutures(context, futures, pixel) {
    context.lineWidth = Math.max(0.25, 1.2 * pixel);
    context.strokeStyle = FUTURE_COLOUR;
    for (const { samples } of futures.agents) {
      context.beginPath();
      for (const points of samples) {
        points.forEach((point, index) => (index ? context.lineTo(...point) : context.moveTo(...point)));
      }
      context.stroke();
    }
  }

  drawAgents(context, tracks, pixel) {
    const { time, selected, colouring, shown } = this.state;
    const trails = shown("trails");
    const { from, to, colours } = tracks.speeds;
    const getSpeedColour = (speed) => {
      const share = (3.6 * (speed ?? 0) - from) / (to - from);
      return colours[Math.round(Math.min(Math.max(share, 0), 1) * (colours.length - 1))];
    };
    const getColour = (agent) =>
      colouring === "speed" ? getSpeedColour(getSpeed(tracks, agent, time)) : tracks.colours[agent.type];
    const boxes = new Map();
    for (const agent of tracks.agents) {
      const pose = getPose(tracks, agent, time);
      if (!pose) continue;
      const own = agent === selected;
      const colour = own ? SELECTED_COLOUR : getColour(agent);
      if (!boxes.has(colour)) boxes.set(colour, new Path2D());
      const path = boxes.get(colour);
      const scale = Math.max(1, (LEAST_PX * pixel) / Math.max(agent.length, agent.width));
      getBox(pose, scale * agent.length, scale * agent.width).forEach((corner, index) =>
        index ? path.lineTo(...corner) : path.moveTo(...corner),
      );
      path.closePath();
      if (own || trails) this.drawTrail(context, tracks, agent, colour, pixel);
    }
    context.strokeStyle = "white";
    context.lineWidth = Math.min(0.15, pixel);
    for (const [colour, path] of boxes) {
      context.fillStyle = colour;
      context.fill(path);
      context.stroke(path);
    }
  }

  drawTrail(context, tracks, agent, colour, pixel) {
    const { times, origin } = tracks;
    const { time } = this.state;
    context.lineWidth = Math.max(0.3, 2 * pixel);
    context.strokeStyle = colour;
    context.beginPath();
    const begin = Math.max(findStep(times, time - TRAIL_S), agent.first);
    const end = Math.min(findStep(times, time), agent.first + agent.steps - 1);
    for (let step = begin; step <= end; step++) {
      const at = 4 * (step - agent.first);
      if (!isPresent(agent, step - agent.first)) continue;
      context.lineTo(agent.states[at] + origin[0], agent.states[at + 1] + origin[1]);
    }
    const pose = getPose(tracks, agent, time);
    if (pose) context.lineTo(pose[0], pose[1]);
    context.stroke();
  }
}
