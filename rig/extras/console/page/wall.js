// The wall and the run: fields for the next run, sliders that change the running wall, and the limits by theory.

import { cleared, colour, make, setText, showStage, written } from "./dom.js";
import { Estimator } from "./estimator.js";

const ASK_MS = 250; // between two requests for the theory while a slider moves
const SET_MS = 100;
const JOBS = ["hit", "play"]; // those of this view
const STARTING = "starting …";
const SLIDERS = { "wall.stiffness": ["stiffness K", "stiffness"], "wall.damping": ["damping B", "damping"], "wall.position": ["position", "position"] }; // label, quantity

export class Wall {
  constructor(link, facts) {
    this.link = link;
    this.units = facts.units;
    this.fields = {};
    this.labels = {};
    this.motion = "rotary";
    this.chosen = {};
    this.sent = {}; // values sent to the running loop: browsers fire `change` twice for one value
    this.estimator = new Estimator(facts, () => this.#theory());
    this.rig = make("select", { onchange: () => this.#load() }, ...facts.rigs.map((name) => make("option", { value: name, textContent: name })));
    this.url = make("input", { type: "text", value: "sim://", ariaLabel: "Device" });
    this.detached = make("input", { type: "checkbox" });
    this.simulated = facts.simulated === true; // in this page, for rates of a table
    this.rates = make("select", { onchange: () => this.#setRates() });
    this.bands = make("canvas", { className: "regions", role: "img" });
    this.legend = make("p", { className: "quiet", role: "status" });
    this.sets = make("p", { className: "quiet", role: "status" });
    this.verdict = make("div", { role: "status", ariaLive: "polite" });
    this.play = make("button", { type: "button", className: "first", textContent: "Drag the handle", onclick: () => this.#start("play") });
    this.hit = make("button", { type: "button", textContent: "Automatic hit", onclick: () => this.#start("hit") });
    this.element = make("div", {}, this.#run(), this.#wall());
    link.addEventListener("loop", ({ detail }) => this.#another(detail));
    link.addEventListener("state", ({ detail }) => this.#state(detail));
    link.addEventListener("job", ({ detail }) => JOBS.includes(detail.job) && this.#job(detail));
    link.addEventListener("progress", ({ detail }) => JOBS.includes(detail.job) && this.#progress(detail.told));
    this.rig.value = facts.rigs.includes("koul-compliant") ? "koul-compliant" : facts.rigs[0];
    this.#load();
  }

  #run() {
    return make("section", { className: "panel" }, make("h2", { textContent: "Run" }),
      field("rig", this.rig), ...(this.simulated ? [] : [field("device", this.url),
        make("label", { className: "quiet", title: "an automatic hit runs to its end even if this page closes" }, this.detached, " continue when this page closes")]),
      make("p", {}, this.play, " ", this.hit), this.verdict);
  }

  #wall() {
    const rates = (name, label) => field(label, this.#number(name, 0));
    return make("section", { className: "panel" }, make("h2", { textContent: "Wall" }),
      this.#slider("wall.stiffness"), make("div", { className: "field" }, make("span"), this.bands), this.#slider("wall.damping"), this.#slider("wall.position"),
      this.legend, this.sets,
      make("h2", { textContent: "Settings of the next run" }),
      ...(this.simulated ? [field("1/T1, 1/T2 (Hz)", this.rates)] : [rates("controller.position_rate", "1/T1 (Hz)"), rates("controller.velocity_rate", "1/T2 (Hz)")]),
      this.estimator.element);
  }

  #number(key, step) {
    const input = make("input", { type: "number", step: step || "any", onchange: () => this.#changed(key) });
    this.fields[key] = input;
    return input;
  }

  #slider(key) {
    const [label] = SLIDERS[key];
    const number = this.#number(key);
    number.ariaLabel = label;
    const range = make("input", { type: "range", min: 0, max: 1000, ariaLabel: `${label}, slider`, oninput: () => {
      number.value = written(this.#ofSlider(key, Number(range.value)), 3);
      this.#changed(key);
    } });
    this.fields[`${key}~`] = range;
    this.labels[key] = make("span", { textContent: label });
    return make("label", { className: "field" }, this.labels[key], range, number);
  }

  #unit(key) {
    return this.units[SLIDERS[key][1]][this.motion];
  }

  // Label the wall with the units of the rig that is shown.
  #label(motion) {
    this.motion = motion;
    for (const key of Object.keys(SLIDERS)) setText(this.labels[key], `${SLIDERS[key][0]} (${this.#unit(key)})`);
  }

  #ofSlider(key, place) {
    const [low, high] = this.ranges?.[key] ?? [0, 1];
    return low + (high - low) * place / 1000;
  }

  #place(key) {
    const [low, high] = this.ranges?.[key] ?? [0, 1];
    const slider = this.fields[`${key}~`];
    slider.value = Math.round(1000 * (Number(this.fields[key].value) - low) / (high - low || 1));
    slider.setAttribute("aria-valuetext", `${this.fields[key].value} ${this.#unit(key)}`);
  }

  #setRates() {
    const [position_rate, velocity_rate] = this.rates.value.split("/").map(Number);
    Object.assign(this.chosen, { "controller.position_rate": position_rate, "controller.velocity_rate": velocity_rate });
    this.#theory();
  }

  async #load() {
    try {
      this.#fill(await this.link.ask("experiment", { rig: this.rig.value }));
    } catch (error) {
      this.#trouble(error);
    }
  }

  // Show a rig with changes by dotted key.
  async choose(rig, changes) {
    this.rig.value = rig;
    await this.#load();
    for (const [key, value] of Object.entries(changes)) {
      if (this.fields[key]) this.fields[key].value = written(value, 6);
      if (this.fields[`${key}~`]) this.#place(key);
    }
    this.chosen = { ...changes };
    delete this.chosen["controller.estimator"];
    if (changes["controller.estimator"]) this.estimator.choose(changes["controller.estimator"]);
    this.rates.value = `${changes["controller.position_rate"] ?? this.experiment.controller.position_rate}/${changes["controller.velocity_rate"] ?? this.experiment.controller.velocity_rate}`;
    this.#theory();
  }

  // Show an experiment's numbers, and what a change of them is measured against.
  #fill(experiment) {
    this.experiment = experiment;
    const { wall, controller, trial } = experiment;
    const reach = Math.abs(wall.position - trial.start) || 0.01;
    this.ranges = { "wall.stiffness": [0, 4 * wall.stiffness || 100], "wall.damping": [0, 5 * wall.damping || 1], "wall.position": [wall.position - reach / 2, wall.position + reach] };
    const values = { "wall.stiffness": wall.stiffness, "wall.damping": wall.damping, "wall.position": wall.position,
      "controller.position_rate": controller.position_rate, "controller.velocity_rate": controller.velocity_rate };
    for (const [key, value] of Object.entries(values)) if (this.fields[key]) this.fields[key].value = written(value, 6);
    this.rates.replaceChildren(...(experiment.rates ?? []).map(([t1, t2]) => make("option", { value: `${t1}/${t2}`, textContent: t1 === t2 ? `${t1}, uniform` : `${t1}, ${t2}` })));
    this.rates.value = `${controller.position_rate}/${controller.velocity_rate}`;
    this.estimator.fill(controller);
    this.#label(experiment.rig.motion);
    for (const key of Object.keys(this.ranges)) this.#place(key);
    this.chosen = {};
    this.#theory();
  }

  #changed(key) {
    if (this.fields[`${key}~`]) this.#place(key);
    const value = Number(this.fields[key].value);
    this.chosen[key] = key.endsWith("rate") ? Math.round(value) : value;
    if (key.startsWith("wall.") && this.running && this.sent[key] !== value) this.#set(key);
    this.#theory();
  }

  #changes() {
    return { ...this.chosen, ...this.estimator.changes };
  }

  // Change the running wall, a few times a second while a slider moves; the last value is always sent.
  #set(key) {
    this.pending = { ...this.pending, [key]: this.chosen[key] };
    this.sent[key] = this.chosen[key];
    if (this.setting) return;
    this.setting = true;
    const changes = this.pending;
    this.pending = null;
    this.link.ask("set", { changes }).then((done) => { this.set = done.number; }, (error) => { this.sent = {}; this.#trouble(error); })
      .finally(() => setTimeout(() => {
        this.setting = false;
        if (this.pending) this.#set(Object.keys(this.pending)[0]);
      }, SET_MS));
  }

  #theory() {
    this.link.dispatchEvent(new CustomEvent("chosen", { detail: { rig: this.rig.value, changes: this.#changes() } }));
    clearTimeout(this.later);
    this.later = setTimeout(async () => {
      if (this.asking) return this.#theory();
      this.asking = true;
      try {
        const damping = Math.max(0, Number(this.fields["wall.damping"].value) || 0);
        const scheme = Object.fromEntries(Object.entries(this.#changes()).filter(([key]) => key.startsWith("controller.")));
        this.regions = await this.link.ask("regions", { rig: this.rig.value, damping, changes: scheme, delay_ticks: this.delay ?? 1 });
        this.estimator.complain(null);
        this.#drawRegions();
      } catch (error) {
        this.estimator.complain(error.message);
      } finally {
        this.asking = false;
      }
    }, ASK_MS);
  }

  #drawRegions() {
    const { note } = this.regions;
    const { context, width, height } = cleared(this.bands);
    const [low, high] = this.ranges["wall.stiffness"];
    const x = (value) => Math.max(0, Math.min(1, (value - low) / (high - low))) * width;
    const paint = (from, to, name) => { context.fillStyle = colour(name); context.fillRect(x(from), 0, x(to) - x(from), height); };
    const shown = describeRegions(this.regions, Number(this.fields["wall.stiffness"].value), this.#unit("wall.stiffness"), !this.simulated);
    for (const [from, to, name] of shown.bands) paint(from ?? low, to ?? high, name);
    const delay = this.simulated ? "" : ` with ${this.delay ?? 1} tick${this.delay === 1 || !this.delay ? "" : "s"} of delay${this.delay === undefined ? " (assumed)" : " (measured)"}`;
    setText(this.legend, `By linear theory${delay}: ${shown.text}${note ? `; ${note}` : ""}.`);
    this.bands.ariaLabel = this.legend.textContent;
  }

  async #start(job) {
    this.verdict.replaceChildren(STARTING);
    try {
      await this.link.ask("run", { job, rig: this.rig.value, url: this.url.value, changes: this.#changes(), is_detached: this.detached.checked });
    } catch (error) {
      this.verdict.replaceChildren();
      this.#trouble(error);
    }
  }

  #another(loop) {
    this.delay = loop.gate?.delay_ticks;
    const wall = loop.experiment?.wall;
    if (!wall) return;
    this.#label(loop.experiment.rig?.motion ?? this.motion);
    for (const key of ["stiffness", "damping", "position"]) {
      if (document.activeElement !== this.fields[`wall.${key}~`]) this.fields[`wall.${key}`].value = written(wall[key], 6);
    }
    for (const key of Object.keys(this.ranges ?? {})) if (document.activeElement !== this.fields[`${key}~`]) this.#place(key);
    this.#theory();
  }

  #state(state) {
    this.running = state.loop !== null && state.loop.ended === null;
    if (this.running) this.#forgetStart();
    const busy = state.job !== null;
    this.play.disabled = this.hit.disabled = busy || (state.operated && !state.operates);
    const loop = state.loop;
    if (!this.running || loop.set > (this.set ?? 0)) this.sent = {}; // changed by another page or by `rig set`
    setText(this.sets, !this.running || (!loop.set && !this.set) ? "" : loop.set < (this.set ?? 0)
      ? `Parameter set ${this.set} becomes active when the handle is outside the wall; set ${loop.set} is active now.` : `Parameter set ${loop.set} is active.`);
  }

  #progress(report) {
    showStage(this.verdict, `${report.stage}${report.why ? `: ${report.why}` : ""}`, report.share);
  }

  #job({ job, told: report }) {
    if (!JOBS.includes(job)) return;
    if (report.say === "compiling" && report.busy) this.verdict.replaceChildren("compiling for this run, once per version and computer …");
    if (report.say === "failed") {
      this.verdict.replaceChildren(make("p", { dataset: { kind: report.kind }, textContent: `The ${job} ended: ${report.error}${report.remedy ? `; ${report.remedy}` : ""}${report.recording ? `. Recorded: ${report.recording}` : ""}` }));
    }
    if (report.say === "done") this.verdict.replaceChildren(...report.result.map(verdictOf));
    if (report.say === "ended") {
      this.set = undefined;
      this.#forgetStart();
    }
  }

  #forgetStart() {
    if (this.verdict.textContent === STARTING) this.verdict.replaceChildren();
  }

  #trouble(error) {
    this.link.dispatchEvent(new CustomEvent("trouble", { detail: error }));
  }
}

// What theory says about a stiffness: a text, and bands of colour from one stiffness (null: the least) to another (null: the
// greatest). `passivity`: a page without a server has no passive walls in its tables and shows stability alone. A passive limit
// that is missing (null) is no limit of zero, with which no wall is passive.
export function describeRegions({ passive, stable, hand }, stiffness, unit, passivity) {
  if (stable === null) return { text: "no theoretical limit", bands: [[null, null, "invalid"]] };
  const known = passivity && passive !== null;
  const bands = known ? [[null, passive, "stable"], [passive, stable, "limit-cycle"]] : [[null, stable, passivity ? "invalid" : "stable"]];
  const now = stiffness > stable ? "unstable" : !known ? "stable" : passive > 0 && stiffness <= passive ? "passive" : "stable, not passive";
  const limit = !passivity ? "" : !known ? "passivity not computed, " : passive > 0 ? `passive up to ${written(passive, 3)}, ` : "no wall is passive, ";
  return { text: `${now} (${limit}stable up to ${written(stable, 3)} ${unit}, ${hand})`, bands: [...bands, [stable, null, "unstable"]] };
}

// One hit's verdict with its numbers.
function verdictOf(hit) {
  const verdict = hit.verdict ?? {};
  return make("div", {}, make("span", { className: "verdict", dataset: { kind: verdict.kind ?? "" }, textContent: verdict.kind ?? "no verdict" }),
    make("p", { className: "quiet", textContent: verdict.reason ?? "" }),
    make("p", { className: "quiet", textContent: [`K ${written(hit.stiffness)}`, `B ${written(hit.damping)}`, hit.recording].filter(Boolean).join(", ") }));
}

function field(label, input) {
  input.ariaLabel ??= label;
  return make("label", { className: "field" }, make("span", { textContent: label }), input);
}
