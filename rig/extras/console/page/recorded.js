// The scope of a recording: the same charts as the live one; what is zoomed into is asked for in detail, a replay lies over it.

import { byKeys } from "./chart_keys.js";
import { NAMES, chartOptions, inside, nameSeries, selected, shadeWall, upright } from "./charts.js";
import { colour, make, written } from "./dom.js";
import { SAVED, drawPlane, planeOf } from "./effort_plane.js";
import { frameOf } from "./link.js";
import { FORMS, saveSeen, savedAs, saving } from "./save.js";
import { Traces } from "./traces.js";

const CHARTS = [
  { title: "position", series: [["handle_position_true", "true"], ["position", "measured"]] },
  { title: "velocity", series: [["handle_velocity_true", "true"], ["velocity", "measured"]] },
  { title: "effort", series: [["effort_wanted", "other"], ["effort_sent", "sent"], ["effort_applied", "measured"]] },
];
const OVER = { velocity: "velocity", effort: "effort_sent" }; // which column of a replay lies over which chart
const TRUE = { handle_position_true: "handle (true)", handle_velocity_true: "handle (true)" };
const PLANE = ["penetration", "effort_applied"];
const IMPACT_S = [-0.02, 0.1]; // about the first contact

export class Recorded {
  constructor(link, trouble, saved) {
    this.link = link;
    this.trouble = trouble;
    this.saved = saved;
    this.traces = new Traces();
    this.replayed = null;
    this.cursors = [];
    this.plots = [];
    const step = (textContent, ariaLabel, move) => make("button", { type: "button", textContent, ariaLabel, title: ariaLabel, onclick: () => this.#show(...move(...this.shown)) });
    this.also = make("select", { ariaLabel: "Show also", onchange: () => this.#again() });
    this.through = make("select", { ariaLabel: "Replay through", onchange: () => this.#again() });
    this.readout = make("p", { className: "quiet", role: "status" });
    this.charts = make("div", { className: "charts" });
    byKeys(this.charts, { range: () => this.shown, cursor: () => this.cursors.at(-1), move: (at) => this.#setCursors([...this.cursors.slice(0, -1), at]),
      place: (at) => this.#cursor(at), zoom: (first, last) => this.#show(first, last) });
    this.plane = make("button", { type: "button", textContent: "Effort over penetration", ariaPressed: "false", onclick: () => {
      this.plane.ariaPressed = String(!this.#isPlane());
      this.#again();
    } });
    this.element = make("div", { className: "map", hidden: true }, make("div", { className: "bar" },
      step("Whole", "Show the whole recording", () => [0, this.facts.length_s]),
      this.impact = step("Impact", "Show the first contact", () => IMPACT_S.map((at) => this.facts.contact_s + at)),
      step("+", "Zoom in", (first, last) => [first + (last - first) / 4, last - (last - first) / 4]),
      step("−", "Zoom out", (first, last) => [first - (last - first) / 2, last + (last - first) / 2]),
      step("◀", "Earlier", (first, last) => [first - (last - first) / 2, last - (last - first) / 2]),
      step("▶", "Later", (first, last) => [first + (last - first) / 2, last + (last - first) / 2]),
      make("label", {}, "show also ", this.also), make("label", {}, "replay through ", this.through),
      this.plane, saving(FORMS, (form) => this.#save(form))), this.readout, this.charts);
    new ResizeObserver(() => this.#size()).observe(this.charts);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.#build());
  }

  async show(facts) {
    this.facts = facts;
    this.units = Object.fromEntries(facts.columns.map(({ name, unit }) => [name, unit]));
    const options = (none, names) => [make("option", { value: "", textContent: none }), ...names.map((name) => make("option", { value: name, textContent: name }))];
    this.also.replaceChildren(...options("nothing", facts.columns.map(({ name }) => name)));
    this.through.replaceChildren(...options("nothing", facts.estimators));
    this.impact.disabled = facts.contact_s === null;
    this.plane.disabled = !(facts.wall && PLANE.every((column) => column in this.units));
    if (this.plane.disabled) this.plane.ariaPressed = "false";
    this.element.hidden = false;
    this.cursors = [];
    this.readout.textContent = "";
    await this.#show(0, facts.length_s);
  }

  clear() {
    this.element.hidden = true;
  }

  #isPlane() {
    return this.plane.ariaPressed === "true";
  }

  #unit(column) {
    return this.units[column] ?? "";
  }

  #save(form) {
    if (form === "cut") {
      this.#cut();
      return;
    }
    const unit = (column) => this.#unit(column);
    saveSeen(form, {
      traces: this.traces, unit, charts: this.#charts(), range: this.shown, canvases: [...this.charts.querySelectorAll("canvas")],
      plane: this.#isPlane() ? planeOf(this.traces, this.facts.wall, unit, SAVED) : undefined,
    }, this.facts.name.replace(/\.[^.]*$/, ""));
  }

  async #cut() {
    const { name, map } = this.facts;
    const [first_s, last_s] = this.shown;
    try {
      this.readout.textContent = savedAs(await this.link.ask("recording-cut", { name, map, first_s, last_s }));
      this.saved();
    } catch (error) {
      this.trouble(error);
    }
  }

  #again() {
    return this.#show(...this.shown);
  }

  async #show(from, to) {
    const { name, map, length_s } = this.facts;
    const span = Math.min(to - from, length_s);
    const first = Math.min(Math.max(0, from), length_s - span);
    this.shown = [first, first + span];
    this.asked = (this.asked ?? 0) + 1;
    const asked = this.asked;
    const fetch = async (content) => {
      const query = new URLSearchParams({ first: this.shown[0], last: this.shown[1], ...(map && { map }), ...content });
      const blob = await this.link.fetch(`/recordings/${encodeURIComponent(name)}/cut?${query}`);
      return frameOf(await blob.arrayBuffer());
    };
    try {
      const estimator = this.through.value;
      if (estimator) this.readout.textContent = `replaying through ${estimator} …`;
      const columns = [...new Set([...this.#charts().flatMap(({ series }) => series.map(([column]) => column)), ...(this.#isPlane() ? PLANE : [])])];
      const frame = await fetch({ columns: columns.join() });
      const replay = estimator ? await fetch({ estimator }) : null;
      if (asked !== this.asked) return;
      this.traces = tracesOf(frame);
      this.replayed = replay && tracesOf(replay);
      if (replay) this.readout.textContent = `Through ${replay.estimator} the velocity differs by ${written(replay.velocity_difference, 3)} ${this.units.velocity} rms, `
        + `the effort by ${written(replay.effort_difference, 3)} ${this.units.effort_sent} rms${replay.exact ? ": identical to the last bit" : ""}; the handle's motion is the recorded one.`;
      else this.#read();
      this.#build();
    } catch (error) {
      if (asked === this.asked) this.readout.textContent = "";
      this.trouble(error);
    }
  }

  #charts() {
    const also = this.also.value ? [{ title: this.also.value, series: [[this.also.value, "more"]] }] : [];
    return [...CHARTS, ...also].map(({ title, series }) => ({ title, series: series.filter(([column]) => column in this.units) }));
  }

  #build() {
    if (!this.facts) return;
    for (const plot of this.plots) plot.destroy();
    this.plots = [];
    this.charts.replaceChildren();
    if (this.#isPlane()) {
      const canvas = make("canvas", { className: "plane", role: "img", ariaLabel: "Effort over penetration, with the ideal wall" });
      this.charts.append(canvas);
      drawPlane(canvas, this.traces, this.facts.wall, (column) => this.#unit(column));
      return;
    }
    const charts = this.#charts();
    this.plots = charts.map(({ title, series }, number) => {
      const over = this.replayed && OVER[title] ? [[OVER[title], "more"]] : [];
      const named = [...series.map(([column, key]) => [TRUE[column] ?? NAMES[column] ?? column, key]), ...over.map(() => [`replayed: ${this.through.value}`, "more"])];
      const options = chartOptions({
        title, series: [...series, ...over], unit: this.units[series[0][0]], last: number === charts.length - 1, group: "recorded",
        range: () => this.shown,
        marks: (plot) => inside(plot, () => {
          if (title === "position" && this.facts.wall) shadeWall(plot, this.facts.wall);
          nameSeries(plot, named);
          for (const at of this.cursors) upright(plot, at, colour("ink"));
        }),
        zoom: (plot) => {
          const times = selected(plot);
          if (times) this.#show(...times);
        },
        click: (plot) => this.#cursor(plot.posToVal(plot.cursor.left, "x")),
      });
      const data = [this.traces.series(), ...series.map(([column]) => this.traces.series(column)), ...over.map(([column]) => this.replayed.series(column))];
      return new uPlot(options, data, this.charts);
    });
    this.#size();
  }

  #size() {
    if (this.#isPlane()) this.#build();
    for (const plot of this.plots) plot.setSize({ width: this.charts.clientWidth, height: Math.max(110, Math.floor(this.charts.clientHeight / this.plots.length)) });
  }

  // One cursor shows the values there, two show the differences.
  #cursor(at) {
    this.#setCursors(this.cursors.length === 1 ? [this.cursors[0], at] : [at]);
  }

  #setCursors(times) {
    this.cursors = times;
    this.#read();
    for (const plot of this.plots) plot.redraw(false);
  }

  #read() {
    const times = this.traces.series();
    const places = this.cursors.map((at) => Math.max(0, Math.min(times.length - 1, times.findIndex((one) => one >= at))));
    if (!places.length) {
      this.readout.textContent = "";
      return;
    }
    const value = (column) => places.length === 1 ? this.traces.series(column)[places[0]] : this.traces.series(column)[places[1]] - this.traces.series(column)[places[0]];
    const sign = places.length === 1 ? "" : "Δ";
    const columns = ["position", "velocity", "effort_sent", "effort_applied"].filter((column) => column in this.units);
    this.readout.textContent = [`${sign}t ${written(value(), 5)} s`, ...columns.map((column) => `${sign}${column.replace("_", " ")} ${written(value(column))} ${this.units[column]}`)].join(", ");
  }
}

function tracesOf(frame) {
  const traces = new Traces();
  traces.add(frame);
  return traces;
}
