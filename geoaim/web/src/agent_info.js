/** What is known of an agent, in words: for the pointer, and for the one that is selected. */
import { formatSpeed } from "./dom.js";
import { getSpeed } from "./tracks.js";

/** List what is known of an agent at a time, as pairs of a name and a value. */
export function listFacts(tracks, agent, time) {
  const { times } = tracks;
  const speed = getSpeed(tracks, agent, time);
  const [begin, end] = [times[agent.first], times[agent.first + agent.steps - 1]];
  return [
    ["speed", speed === null ? "not seen now" : formatSpeed(speed)],
    ["size", `${agent.length.toFixed(1)} × ${agent.width.toFixed(1)} m`],
    ["seen", `${begin.toFixed(1)} to ${end.toFixed(1)} s (${(end - begin).toFixed(1)} s)`],
  ];
}

/** The same in one line. */
export function describeAgent(tracks, agent, time) {
  const facts = listFacts(tracks, agent, time).map(([name, value]) => (name === "seen" ? `seen ${value}` : value));
  return [`${agent.type} ${agent.id}`, ...facts].join(" · ");
}
