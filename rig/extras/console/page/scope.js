// The oscilloscope: charts over time, or effort over penetration; pause, zoom, cursors, trigger; what is seen is saved.

import { byKeys } from "./chart_keys.js";
import { NAMES, chartOptions, inside, nameSeries, selected, shadeWall, upright } from "./charts.js";
import { colour, make, written } from "./dom.js";
import { SAVED, drawPlane, planeOf } from "./effort_plane.js";
import { FORMS, saveSeen, savedAs, saving } from "./save.js";
import { Traces } from "./traces.js";

const WINDOWS_S = [0.01, 0.02, 0.05, 0.1, 0.2, 0.5, 1, 2, 5, 10, 20, 60];
const CHARTS = [
  { title: "position", series: [["position", "measured"]] },
  { title: "velocity", series: [["velocity", "measured"]] },
  { title: "effort", series: [["effort_wanted", "other"], ["effort_sent", "sent"], ["effort_applied", "measured"]] },
];
const TRUTH = [
  { title: "position", name: "hand (true)", place: 1, key: "other" },
  { title: "position", name: "handle (true)", place: 2, key: "true" },
  { title: "velocity", name: "true", place: 3, key: "true" },
];
const ALWAYS = ["position", "velocity", "effort_wanted", "effort_sent", "effort_applied", "penetration"];

export class Scope {
  constructor(link, facts) {
    this.link = link;
    this.units = Object.fromEntries(facts.columns.map((column) => [column.name, column.unit]));
    const known = ([name]) => name in this.units;
    this.always = ALWAYS.filter((name) => known([name]));
    this.usual = CHARTS.map(({ title, series }) => ({ title, series: series.filter(known) }));
    this.traces = new Traces();
    this.truth = []; // of a simulated handle: time, hand, handle, velocity
    this.window_s = 2;
    this.paused = false;
    this.extra = "";
    this.plane = false;
    this.cursors = [];
    this.drawn = { frames: 0, latency: [] };
    this.element = make("section", { className: "scope", ariaLabel: "Scope" }, this.#bar(facts), this.#charts(), this.readout);
    link.addEventListener("frame", ({ detail }) => this.#take(detail));
    link.addEventListener("hand", ({ detail }) => this.#feel(detail.motions));
    link.addEventListener("loop", ({ detail }) => this.#another(detail));
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#build());
    new ResizeObserver(() => this.#size()).observe(this.charts);
    this.#build();
    requestAnimationFrame(() => this.#draw());
  }

  get motion() {
    return this.loop?.experiment?.rig?.motion ?? "rotary";
  }

  get wall() {
    return this.loop?.experiment?.wall ?? null;
  }

  unit(name) {
    return this.units[name]?.[this.motion] ?? "";
  }

  // The bar above the charts.

  #bar(facts) {
    const choice = (label, values, value, onchange) =>
      make("label", {}, `${label} `, make("select", { ariaLabel: label, onchange: ({ target }) => onchange(target.value) },
        ...values.map(([text, key]) => make("option", { value: key, textContent: text, selected: key === value }))));
    const columns = facts.columns.map((column) => [column.name, column.name]);
    this.pauseButton = make("button", { type: "button", textContent: "Pause", ariaPressed: "false", onclick: () => this.pause(!this.paused) });
    this.levelField = make("input", { type: "number", step: "any", value: "0", ariaLabel: "Trigger level", onchange: () => this.#ask() });
    this.levelField.style.width = "6rem";
    this.trigger = { on: "", edge: "rising", before: 0.2, single: false };
    this.readout = make("p", { className: "quiet", role: "status" });
    return make("div", { className: "bar" },
      this.pauseButton,
      choice("window", WINDOWS_S.map((s) => [s < 1 ? `${s * 1000} ms` : `${s} s`, String(s)]), "2", (value) => this.#window(Number(value))),
      choice("trigger", [["none", ""], ["contact", "contact"], ...columns], "", (value) => this.#trigger({ on: value })),
      this.levelField,
      choice("edge", [["rising", "rising"], ["falling", "falling"]], "rising", (value) => this.#trigger({ edge: value })),
      choice("before", [["0 %", "0"], ["20 %", "0.2"], ["50 %", "0.5"], ["80 %", "0.8"]], "0.2", (value) => this.#trigger({ before: Number(value) })),
      make("label", {}, make("input", { type: "checkbox", onchange: ({ target }) => this.#trigger({ single: target.checked }) }), " single"),
      make("button", { type: "button", textContent: "Rearm", title: "wait for the next trigger", onclick: () => this.#ask() }),
      choice("show also", [["nothing", ""], ...columns], "", (value) => this.#also(value)),
      make("button", { type: "button", textContent: "Effort over penetration", ariaPressed: "false",
        onclick: ({ target }) => this.#planeView(target) }),
      saving(FORMS.filter(([, form]) => form !== "cut" || !facts.simulated), (form) => this.#save(form)));
  }

  pause(paused) {
    this.paused = paused;
    this.pauseButton.textContent = paused ? "Continue" : "Pause";
    this.pauseButton.ariaPressed = String(paused);
    if (!paused) this.zoomed = null;
    this.#ask();
  }

  #window(seconds) {
    this.window_s = seconds;
    this.zoomed = null;
    this.#ask();
  }

  #trigger(change) {
    Object.assign(this.trigger, change);
    this.#ask();
  }

  #also(name) {
    this.extra = name;
    this.#build();
    this.#ask();
  }

  #planeView(button) {
    this.plane = !this.plane;
    button.ariaPressed = String(this.plane);
    this.#build();
  }

  #columns() {
    return [...new Set([...this.always, ...(this.extra ? [this.extra] : [])])];
  }

  #ask() {
    const { on, edge, before, single } = this.trigger;
    const trigger = on ? { on, edge, before, single, level: Number(this.levelField.value) || 0 } : null;
    const wanted = { columns: this.#columns(), window_s: this.window_s, trigger, paused: this.paused };
    this.link.ask("show", wanted).catch((error) => this.link.dispatchEvent(new CustomEvent("trouble", { detail: error })));
  }

  // Data.

  #another(loop) {
    const same = this.loop && this.loop.pid === loop.pid && this.loop.since === loop.since;
    const motion = this.motion;
    this.loop = loop;
    if (same) return;
    this.truth = [];
    this.zoomed = null;
    if (this.motion !== motion) this.#build();
    this.#ask();
  }

  #take(frame) {
    if (frame.kind === "zoom") {
      if (!this.zoomed) return;
      this.zoomed = new Traces();
      this.zoomed.add(frame);
    } else {
      this.traces.add(frame);
      this.triggered = frame.at ?? null;
      if (frame.kind === "live") this.traces.forget(this.traces.newest - this.window_s);
      this.newest = frame.newest;
    }
    this.stale = true;
  }

  #feel(motions) {
    this.truth.push(...motions);
    const newest = this.truth.at(-1)[0];
    while (this.truth.length && (this.truth[0][0] < newest - this.window_s || this.truth.length > 40000)) this.truth.shift();
    this.hand = this.truth.at(-1);
  }

  // Charts.

  #charts() {
    this.charts = make("div", { className: "charts" });
    byKeys(this.charts, { range: () => this.#range(), cursor: () => this.cursors.at(-1), move: (at) => this.#setCursors([...this.cursors.slice(0, -1), at]),
      place: (at) => this.#cursor(at), zoom: (first_s, last_s) => this.#zoom([first_s, last_s]) });
    return this.charts;
  }

  #shown() {
    return [...this.usual, ...(this.extra ? [{ title: this.extra, series: [[this.extra, "more"]] }] : [])];
  }

  #build() {
    for (const plot of this.plots ?? []) plot.destroy();
    this.plots = [];
    this.charts.replaceChildren();
    if (this.plane) {
      this.canvas = make("canvas", { className: "plane", role: "img", ariaLabel: "Effort over penetration, with the ideal wall" });
      this.charts.append(this.canvas);
      this.stale = true;
      return;
    }
    for (const { title, series } of this.#shown()) {
      this.plots.push(new uPlot(this.#options(title, series), [[], ...series.map(() => [])], this.charts));
    }
    this.#size();
    this.stale = true;
  }

  #options(title, series) {
    return chartOptions({
      title, series, unit: this.unit(series[0][0]), last: title === this.#shown().at(-1).title, group: "rig",
      range: () => this.#range(), height: (low, high) => this.#height(title, low, high),
      marks: (plot) => this.#marks(plot, title, series),
      zoom: (plot) => this.#zoom(selected(plot)),
      click: (plot) => this.#cursor(plot.posToVal(plot.cursor.left, "x")),
    });
  }

  #size() {
    const count = this.plots?.length || 1;
    for (const plot of this.plots ?? []) {
      plot.setSize({ width: this.charts.clientWidth, height: Math.max(110, Math.floor(this.charts.clientHeight / count)) });
    }
    this.stale = true;
  }

  #source() {
    return this.zoomed instanceof Traces ? this.zoomed : this.traces;
  }

  #range() {
    const from = this.#source();
    if (from === this.zoomed) return [from.oldest, from.newest];
    if (this.triggered !== null && this.triggered !== undefined) {
      const before = this.trigger.before * this.window_s;
      return [this.triggered - before, this.triggered - before + this.window_s];
    }
    return [from.newest - this.window_s, from.newest];
  }

  // The least span of a chart is some steps of its sensor or a share of its limit, so that a constant is drawn flat.
  #height(title, low, high) {
    const rig = this.loop?.experiment?.rig;
    const least = { position: 10 * (rig?.encoder?.resolution ?? 1e-4), velocity: 0.01 * (rig?.limits?.speed ?? 1), effort: 0.02 * (rig?.limits?.effort ?? 1) };
    if (low === null) return [0, least[title] ?? 1];
    const middle = (low + high) / 2;
    const half = Math.max(0.55 * (high - low), (least[title] ?? Math.max(1e-3 * Math.abs(middle), 1e-9)) / 2);
    return [middle - half, middle + half];
  }

  // Draw the true state, the wall, the trigger, the cursors and a legend over a chart.
  #marks(plot, title, series) {
    inside(plot, () => {
      if (title === "position" && this.wall) shadeWall(plot, this.wall);
      const known = this.truth.length && !(this.zoomed instanceof Traces) ? TRUTH.filter(({ title: chart, place }) => chart === title && this.truth.at(-1)[place] !== null) : [];
      for (const { place, key } of known) this.#truth(plot, place, key);
      nameSeries(plot, [...series.map(([name, key]) => [NAMES[name] ?? name, key]), ...known.map(({ name, key }) => [name, key])]);
      if (this.triggered) upright(plot, this.triggered, colour("other"));
      for (const at of this.cursors) upright(plot, at, colour("ink"));
    });
  }

  // A column of the simulated handle's true state.
  #truth(plot, place, key) {
    const { ctx } = plot;
    ctx.strokeStyle = colour(key);
    ctx.lineWidth = devicePixelRatio;
    ctx.setLineDash([4 * devicePixelRatio, 3 * devicePixelRatio]);
    ctx.beginPath();
    this.truth.forEach((one, i) => ctx[i ? "lineTo" : "moveTo"](plot.valToPos(one[0], "x", true), plot.valToPos(one[place], "y", true)));
    ctx.stroke();
    ctx.setLineDash([]);
  }

  #draw() {
    requestAnimationFrame(() => this.#draw());
    if (!this.stale || !this.element.isConnected || this.element.offsetParent === null) return;
    this.stale = false;
    const from = this.#source();
    if (this.plane) drawPlane(this.canvas, from, this.wall, (column) => this.unit(column));
    else this.#drawCharts(from);
    this.drawn.frames++;
    if (this.newest && !this.paused) {
      this.drawn.latency.push(Date.now() - this.newest);
      if (this.drawn.latency.length > 600) this.drawn.latency.shift();
    }
  }

  #drawCharts(from) {
    this.#shown().forEach(({ series }, place) => this.plots[place]?.setData([from.series(), ...series.map(([name]) => from.series(name))]));
  }

  // Zoom and cursors.

  #zoom(times) {
    if (times === null) return;
    const [first_s, last_s] = times;
    if (!this.paused) this.pause(true);
    this.zoomed = this.zoomed ?? true;
    this.link.ask("zoom", { columns: this.#columns(), first_s, last_s }).catch(() => { this.zoomed = null; });
  }

  #cursor(at) {
    this.#setCursors(this.cursors.length === 1 ? [this.cursors[0], at] : [at]);
  }

  #setCursors(times) {
    this.cursors = times;
    this.#read();
    this.stale = true;
  }

  // The values at the cursors, and their differences.
  #read() {
    const from = this.#source();
    const times = from.series();
    const at = this.cursors.map((time) => {
      const place = Math.max(0, Math.min(times.length - 1, times.findIndex((one) => one >= time)));
      return Object.fromEntries([["s", times[place]], ...this.always.map((name) => [name, from.series(name)[place]])]);
    });
    const readings = (values, sign) => Object.entries(values).map(([name, value]) =>
      `${sign}${name === "s" ? "t" : NAMES[name] && !name.startsWith("effort") ? name : name.replace("effort_", "effort ")} ${written(value)} ${name === "s" ? "s" : this.unit(name)}`).join(", ");
    if (!at.length) this.readout.textContent = "";
    else if (at.length === 1) this.readout.textContent = readings(at[0], "");
    else this.readout.textContent = readings(Object.fromEntries(Object.keys(at[0]).map((name) => [name, at[1][name] - at[0][name]])), "Δ");
  }

  // Saving.

  #save(form) {
    if (form === "cut") {
      this.#cut();
      return;
    }
    const unit = (column) => this.unit(column);
    const traces = this.#source();
    saveSeen(form, {
      traces, unit, charts: this.#shown(), range: this.#range(),
      canvases: this.plane ? [this.canvas] : this.plots.map((plot) => plot.root.querySelector("canvas")),
      plane: this.plane ? planeOf(traces, this.wall, unit, SAVED) : undefined,
    }, `scope-${new Date().toISOString().replace(/[:.]/g, "-")}`);
  }

  // Save the visible range as a recording, at full rate.
  #cut() {
    const [first_s, last_s] = this.#range();
    this.link.ask("cut", { first_s, last_s }).then((saved) => { this.readout.textContent = savedAs(saved); },
      (error) => this.link.dispatchEvent(new CustomEvent("trouble", { detail: error })));
  }
}
