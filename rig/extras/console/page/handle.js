// The handle of a simulated rig, to be dragged: the hand where the pointer is, the handle on the coupling's other end.

import { cleared, colour, make, written } from "./dom.js";

const SAY_MS = 40; // between messages; after a second without one the server releases the hand
const SPAN = 0.025; // shown at the handle (m), of a trial that starts at its wall
const MARGIN = 0.05; // of the window that the rig may move in
const PRESS_STEP = 1; // N with each key

export class Handle {
  constructor(link, hint = "Start “Drag the handle”, then drag here or use the arrow keys.") {
    this.link = link;
    this.hint = hint;
    this.wish = null;
    this.press = 0;
    this.canvas = make("canvas", { className: "handle", tabIndex: 0, role: "slider", ariaLabel: "Handle: drag it, or use the arrow keys; up and down press",
      ariaValueNow: "0" });
    this.note = make("p", { className: "quiet" });
    this.element = make("section", { className: "panel" }, make("h2", { textContent: "Handle" }), this.canvas, this.note);
    this.canvas.addEventListener("pointerdown", (event) => this.#grip(event));
    this.canvas.addEventListener("pointermove", (event) => this.dragging && this.#to(event));
    for (const kind of ["pointerup", "pointercancel", "lostpointercapture"]) this.canvas.addEventListener(kind, () => { this.dragging = false; });
    this.canvas.addEventListener("keydown", (event) => this.#key(event));
    setInterval(() => this.#say(), SAY_MS);
    link.addEventListener("hand", ({ detail }) => { this.motion = detail.motions.at(-1); this.stale = true; });
    link.addEventListener("loop", ({ detail }) => this.#another(detail));
    link.addEventListener("job", ({ detail }) => { if (detail.told.say === "ended") this.#let(); });
    requestAnimationFrame(() => this.#draw());
  }

  #another(loop) {
    this.experiment = loop.experiment;
    const { rig, wall, trial } = loop.experiment ?? {};
    if (!rig?.mechanics || !trial) return;
    const radius = rig.motion === "rotary" ? rig.mechanics.handle_radius ?? 1 : 1;
    const reach = 6 * Math.abs(wall.position - trial.start) || SPAN / radius;
    const { position_minimum: lowest, position_maximum: highest } = rig.limits; // beyond these the run ends
    const margin = MARGIN * (highest - lowest);
    this.low = Math.max(wall.position - reach / 2, lowest + margin);
    this.high = Math.min(wall.position + reach / 2, highest - margin);
    this.step = (this.high - this.low) / 100;
    Object.assign(this.canvas, { ariaValueMin: String(this.low), ariaValueMax: String(this.high) });
    this.stale = true;
  }

  // The hand leaves the handle; the pointer and a key that are still held must be pressed anew.
  #let() {
    this.dragging = false;
    this.wish = null;
    this.motion = null;
    this.press = 0;
    this.stale = true;
  }

  #grip(event) {
    this.canvas.setPointerCapture(event.pointerId);
    this.dragging = true;
    this.#to(event);
  }

  #to(event) {
    const { left, width } = this.canvas.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - left) / width));
    this.wish = this.low + share * (this.high - this.low);
    this.#say();
  }

  #key(event) {
    const from = this.wish ?? this.motion?.[1] ?? this.experiment?.trial?.start ?? 0;
    const moves = { ArrowLeft: -1, ArrowRight: 1 };
    const presses = { ArrowUp: 1, ArrowDown: -1 };
    if (!(event.key in moves || event.key in presses)) return;
    event.preventDefault();
    if (event.repeat && this.wish === null) return; // held since before a STOP
    if (event.key in moves) this.wish = Math.min(this.high, Math.max(this.low, from + moves[event.key] * this.step));
    else this.press = Math.min(10, Math.max(0, this.press + presses[event.key] * PRESS_STEP));
    this.#say();
  }

  #say() {
    if (this.wish === null) return;
    this.link.say("hand", { position: this.wish, press: this.press });
    this.stale = true;
  }

  #draw() {
    requestAnimationFrame(() => this.#draw());
    if (!this.stale || this.canvas.offsetParent === null || this.low === undefined) return;
    this.stale = false;
    const { context, width, height } = cleared(this.canvas);
    const x = (position) => (position - this.low) / (this.high - this.low) * width;
    const { wall, rig, trial } = this.experiment;
    const at = x(wall.position);
    context.globalAlpha = 0.25;
    context.fillStyle = colour("wall");
    context.fillRect(wall.side > 0 ? at : 0, 0, wall.side > 0 ? width - at : at, height);
    context.globalAlpha = 1;
    context.fillStyle = colour("wall");
    context.fillRect(at - 1, 0, 2, height);
    const [, hand, handle] = this.motion ?? [0, null, null];
    if (hand !== null) {
      context.strokeStyle = colour("sent"); // the stretch of the coupling is the force that one feels
      context.lineWidth = 3;
      zigzag(context, x(handle), x(hand), height / 2);
    }
    context.fillStyle = colour("measured");
    context.fillRect(x(handle ?? trial.start) - 5, height * 0.2, 10, height * 0.6);
    if (hand !== null) {
      context.fillStyle = colour("other");
      context.beginPath();
      context.arc(x(hand), height / 2, 10, 0, 2 * Math.PI);
      context.fill();
    }
    if (this.wish !== null) {
      context.strokeStyle = colour("ink");
      context.lineWidth = 1;
      context.strokeRect(x(this.wish) - 4, height / 2 - 4, 8, 8);
    }
    const unit = rig.motion === "rotary" ? "rad" : "m";
    this.canvas.ariaValueNow = String(handle ?? trial.start);
    this.canvas.ariaValueText = handle === null ? "at rest" : `handle ${written(handle, 3)} ${unit}`;
    this.note.textContent = handle === null ? this.hint
      : `handle ${written(handle, 3)} ${unit}${hand === null ? ", pushed by the motor" : `, hand ${written(hand, 3)} ${unit}, press ${this.press} N`}`;
  }
}

function zigzag(context, from, to, y) {
  const teeth = 8;
  context.beginPath();
  context.moveTo(from, y);
  for (let i = 1; i < teeth; i++) context.lineTo(from + (to - from) * i / teeth, y + (i % 2 ? -8 : 8));
  context.lineTo(to, y);
  context.stroke();
}
