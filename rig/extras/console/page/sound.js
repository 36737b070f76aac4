// Contact and buzz as sound, from the audible band of the effort; off until the user turns it on.

import { make } from "./dom.js";

const LOUDEST = 0.15;

export class Sound {
  constructor(link) {
    this.box = make("input", { type: "checkbox", onchange: () => this.#turn(this.box.checked) });
    this.element = make("label", { className: "quiet" }, this.box, " play contact and buzz as sound");
    link.addEventListener("frame", ({ detail }) => this.#play(detail));
  }

  #turn(on) {
    if (on && !this.context) {
      this.context = new AudioContext();
      this.gain = new GainNode(this.context, { gain: LOUDEST });
      const high = new BiquadFilterNode(this.context, { type: "highpass", frequency: 30 });
      high.connect(this.gain).connect(this.context.destination);
      this.input = high;
      this.at = 0;
    }
    this.on = on;
  }

  // The efforts of a frame as samples at their own rate, behind those of the one before.
  #play(frame) {
    if (!this.on || frame.kind !== "live" || frame.fresh || frame.points < 2 || !frame.low.effort_applied) return;
    const seconds = frame.times[frame.points - 1] - frame.times[0];
    const rate = Math.min(96000, Math.max(8000, this.context.sampleRate));
    const count = Math.max(2, Math.round(seconds * rate));
    const buffer = new AudioBuffer({ length: count, sampleRate: rate, numberOfChannels: 1 });
    const samples = buffer.getChannelData(0);
    this.loudest = Math.max(1e-6, 0.999 * (this.loudest ?? 0), ...frame.high.effort_applied.map(Math.abs));
    for (let i = 0; i < count; i++) samples[i] = frame.low.effort_applied[Math.floor(i * (frame.points - 1) / (count - 1))] / this.loudest;
    this.at = Math.max(this.at, this.context.currentTime + 0.03);
    const source = new AudioBufferSourceNode(this.context, { buffer });
    source.connect(this.input);
    source.start(this.at);
    this.at += seconds;
  }
}
