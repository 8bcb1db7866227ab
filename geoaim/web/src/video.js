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

  /** The time that the video shows while it leads, or for which it is fetched; null where it does not. */
  get time() {
    const { video, element } = this;
    if (element.hidden || video.error || video.paused || video.ended) return null;
    return video.seeking || video.readyState < 3 ? this.wanted[0] : video.currentTime;
  }

  /** Show the picture of a time; a video that leads is there already. */
  show(time, playing, speed) {
    const { video, element } = this;
    this.wanted = [time, playing, speed];
    video.playbackRate = speed;
    const over = time > video.duration || (video.ended && time >= video.currentTime);
    const shown = !element.hidden && !video.error && !over;
    if (playing && shown && video.paused) video.play().catch(() => {}); // a pause may come before it begins
    if (!(playing && shown) && !video.paused) video.pause();
    const near = playing ? LEAD_S : REST_S;
    if (shown && !video.seeking && Math.abs(video.currentTime - time) > near) video.currentTime = time;
  }
}
