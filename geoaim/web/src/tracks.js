/** Tracks: where each agent is at a time. */

/**
 * Decode tracks.
 *
 * The description has `times` (path of float64 seconds), `path` (float32 x, y, heading, speed of
 * each agent's steps, one agent after the other, metres from `origin` and per second; NaN while
 * absent), `agents`, `colours` by the type of an agent, and the scale of `speeds`.
 */
export async function readTracks(tracks, transport) {
  const [states, times] = await Promise.all([
    transport.read(tracks.path).then((buffer) => new Float32Array(buffer)),
    transport.read(tracks.times).then((buffer) => new Float64Array(buffer)),
  ]);
  let offset = 0;
  const agents = tracks.agents.map((agent) => {
    const begin = offset;
    offset += 4 * agent.steps;
    return { ...agent, states: states.subarray(begin, offset) };
  });
  return { times, agents, origin: tracks.origin, colours: tracks.colours, speeds: tracks.speeds };
}

/** Find the index of the last time that is not after `time`; 0 before the first. */
export function findStep(times, time) {
  let low = 0;
  let high = times.length - 1;
  while (low < high) {
    const middle = (low + high + 1) >> 1;
    if (times[middle] <= time) low = middle;
    else high = middle - 1;
  }
  return low;
}

/** Whether an agent is there at one of its own steps. */
export const isPresent = ({ states }, step) => !Number.isNaN(states[4 * step]);

/** An agent's speed in m/s at the last step until a time; null while absent. */
export function getSpeed({ times }, { first, steps, states }, time) {
  const step = findStep(times, time) - first;
  return step < 0 || step >= steps || Number.isNaN(states[4 * step]) ? null : states[4 * step + 3];
}

/** Interpolate an agent's [x, y, heading] between the steps around a time; null while absent. */
export function getPose(tracks, agent, time) {
  const { times, origin } = tracks;
  const step = findStep(times, time);
  const at = 4 * (step - agent.first);
  const { states } = agent;
  if (at < 0 || at >= states.length || Number.isNaN(states[at])) return null;
  const pose = [states[at] + origin[0], states[at + 1] + origin[1], states[at + 2]];
  if (at + 4 >= states.length || Number.isNaN(states[at + 4])) return pose;
  const share = (time - times[step]) / (times[step + 1] - times[step]);
  if (!(share > 0)) return pose;
  const turn = states[at + 6] - states[at + 2];
  return [
    pose[0] + share * (states[at + 4] - states[at]),
    pose[1] + share * (states[at + 5] - states[at + 1]),
    pose[2] + share * Math.atan2(Math.sin(turn), Math.cos(turn)),
  ];
}

/** The corners of a box: x forward, y left of its pose. */
export function getBox([x, y, heading], length, width) {
  const [cos, sin] = [Math.cos(heading), Math.sin(heading)];
  const corner = (forward, left) => [
    x + (cos * forward * length - sin * left * width) / 2,
    y + (sin * forward * length + cos * left * width) / 2,
  ];
  return [corner(1, 0.6), corner(0.7, 1), corner(-1, 1), corner(-1, -1), corner(0.7, -1), corner(1, -0.6)];
}

/** Find the agent whose box is at a point, with a margin in metres; null if there is none. */
export function findAgent(tracks, time, [x, y], margin) {
  let nearest = null;
  let least = Infinity;
  for (const agent of tracks.agents) {
    const pose = getPose(tracks, agent, time);
    if (!pose) continue;
    const [east, north] = [x - pose[0], y - pose[1]];
    const forward = Math.abs(east * Math.cos(pose[2]) + north * Math.sin(pose[2]));
    const left = Math.abs(north * Math.cos(pose[2]) - east * Math.sin(pose[2]));
    const outside = Math.max(forward - agent.length / 2, left - agent.width / 2);
    if (outside < Math.min(margin, least)) [nearest, least] = [agent, outside];
  }
  return nearest;
}
