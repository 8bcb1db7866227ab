/** The video of the tracks beside the map; while both play, the video is the clock. */
import { make } from "./dom.js";

// nearer the picture stays: less than a frame at 30 Hz at rest; while it leads, only a seek is farther
const [REST_S, LEAD_S] = [0.02, 0.2];

export class VideoBeside {
  /** A video at an address; its time is that of the tracks. */
  constructor(name, address) {
    this.video = make("video", { src: address, muted: true, preload: "auto", playsInline: true });
    this.video.setAttribute("aria-label", `video ${name}`);
    this.caption = make("figcaption", {}, name);
    this.element = make("figure", { className: "video" }, this.video, this.caption);
    this.wanted = [0, false, 1];
    this.video.addEventListener("seeked", () => this.show(...this.wanted)); // what was asked meanwhile
    this.video.addEventListener("error", () => {
      this.caption.textContent = `This browser cannot play ${name}. As H.264 it can: ffmpeg -i ${name} -c:v libx264 -pix_fmt yuv420p NEW.mp4; geoaim view … --video NEW.mp4`;
    });
  }

  /** Whether the video shows what the map shows, so that it can lead. */
  get leads() {
    const { video, element } = this;
    return !element.hidden && !video.error && !video.paused && !video.ended && video.readyState > 2;
  }

  /** Show the picture of a time; a video that leads is there already. */
  show(time, playing, speed) {
    const { video, element } = this;
    this.wanted = [time, playing, speed];
    if (element.hidden || video.error) return;
    video.playbackRate = speed;
    const inside = !(time > video.duration);
    if (playing && video.paused && inside) video.play().catch(() => {}); // a pause may come before it begins
    if (!playing && !video.paused) video.pause();
    const near = this.leads ? LEAD_S : REST_S;
    if (!video.seeking && inside && Math.abs(video.currentTime - time) > near) video.currentTime = time;
  }
}
