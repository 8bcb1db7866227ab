/** The time line: play, seek, speed, and marks of infractions. */
import { make } from "./dom.js";

const SPEEDS = [0.25, 0.5, 1, 2, 5, 10];
const MARK_PLACES = 300; // along the time line
const MARK_COLOURS = { "off road": "#8d5a00", collision: "#c1121f", "red light": "#e000a4" };

/** Make a time line from `begin` to `end` (s) that calls `seek(time)`. */
export class Timeline {
  constructor(begin, end, seek) {
    this.clock = () => null; // the time of what leads while it plays, such as a video; null: nothing
    Object.assign(this, { begin, end, seek, time: begin, speed: 1, playing: false });
    this.play = make("button", { className: "play", title: "Play or pause (space)", ariaLabel: "Play" }, "▶");
    this.slider = make("input", { type: "range", min: begin, max: end, step: "any", value: begin });
    this.slider.setAttribute("aria-label", "time");
    this.label = make("output", { className: "time" });
    const options = SPEEDS.map((speed) => make("option", { value: speed, selected: speed === 1 }, `${speed} ×`));
    this.speeds = make("select", { title: "Playback speed", ariaLabel: "Playback speed" }, ...options);
    this.marks = make("div", { className: "marks" });
    const track = make("div", { className: "track" }, this.marks, this.slider);
    this.element = make("div", { className: "timeline" }, this.play, track, this.label, this.speeds);
    this.play.addEventListener("click", () => this.toggle());
    this.slider.addEventListener("input", () => this.set(Number(this.slider.value)));
    this.speeds.addEventListener("change", () => (this.speed = Number(this.speeds.value)));
    this.set(begin);
  }

  /** Go to a time, within the tracks. */
  set(time) {
    this.time = Math.min(Math.max(time, this.begin), this.end);
    this.slider.value = this.time;
    this.label.value = `${this.time.toFixed(2)} s`;
    this.seek(this.time);
  }

  toggle(playing = !this.playing) {
    this.playing = playing;
    this.play.textContent = playing ? "❚❚" : "▶";
    this.play.ariaLabel = playing ? "Pause" : "Play";
    if (!playing) return this.seek(this.time);
    if (this.time >= this.end) this.set(this.begin);
    let last = null;
    const advance = (now) => {
      if (!this.playing) return;
      if (last !== null) this.set(this.clock() ?? this.time + ((now - last) / 1000) * this.speed);
      last = now;
      if (this.time >= this.end) return this.toggle(false);
      requestAnimationFrame(advance);
    };
    requestAnimationFrame(advance);
  }

  /** Show marks {time, agent, kind}, those of a kind at about one time as one; a click calls `select(mark)`. */
  showMarks(marks, select) {
    const groups = new Map();
    for (const mark of marks) {
      const place = Math.round((MARK_PLACES * (mark.time - this.begin)) / (this.end - this.begin || 1));
      const key = `${place} ${mark.kind}`;
      if (!groups.has(key)) groups.set(key, { place, group: [] });
      groups.get(key).group.push(mark);
    }
    for (const { place, group } of groups.values()) {
      const { kind, agent, time } = group[0];
      const style = `left:${(100 * place) / MARK_PLACES}%;background:${MARK_COLOURS[kind] ?? "#555"}`;
      const others = group.length > 1 ? ` and ${group.length - 1} more` : "";
      const title = `${kind}: agent ${agent} at ${time.toFixed(1)} s${others}`;
      const tick = make("button", { className: "mark", style, title, tabIndex: -1 });
      let next = 0; // each click shows the next one of the group
      tick.addEventListener("click", () => select(group[next++ % group.length]));
      this.marks.append(tick);
    }
  }
}

/** The kinds of marks and their colours, for a legend. */
export function listMarkKinds(marks) {
  return Object.entries(MARK_COLOURS).filter(([kind]) => marks.some((mark) => mark.kind === kind));
}
