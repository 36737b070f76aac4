// Maps of walls: a form that starts one, the list of all, and the plane of stiffness over damping that fills in.

import { make, written } from "./dom.js";
import { Plane } from "./plane.js";

const LIST_MS = 5000;
const HANDS = [["a normal hand", "normal"], ["a relaxed hand", "relaxed"], ["a firm hand", "firm"], ["the motor, with the end mass", "none"]];
const DEFAULTS = { time: "koul-compliant", frequency: "chawda-linear" };

export class Maps {
  // `open` is called with the recording to show.
  constructor(link, facts, open) {
    this.link = link;
    this.open = open;
    this.map = null;
    this.columns = [];
    this.list = make("tbody");
    this.progress = make("p", { className: "quiet", role: "status" });
    this.bar = make("progress", { max: 1, value: 0, hidden: true, ariaLabel: "Share of the map that is done" });
    this.title = make("h2", { textContent: "Choose a map, or start one" });
    this.schemes = make("div", { className: "bar schemes", role: "group", ariaLabel: "Scheme" });
    this.limits = make("table", { className: "limits" });
    this.plane = new Plane((cell) => this.#open(cell));
    this.plane.onchosen = () => this.#table();
    this.plane.element.hidden = true;
    this.element = make("div", {}, this.#side(facts), make("section", { className: "scope", ariaLabel: "Map" },
      make("div", { className: "bar" }, this.title, this.end), this.schemes, this.bar, this.progress, this.plane.element), make("div", { className: "side limits" }, this.limits));
    link.addEventListener("cells", ({ detail }) => this.#take(detail));
    link.addEventListener("hello", () => this.map && this.#watch(this.map.name)); // connected again
    link.addEventListener("state", ({ detail }) => this.#state(detail));
    link.addEventListener("job", ({ detail }) => this.#job(detail));
    link.addEventListener("compiling", ({ detail }) => { this.busy.textContent = detail.busy ? "compiling for this hit, once per version and computer …" : ""; });
    this.#fields();
    this.#load();
    setInterval(() => this.element.offsetParent !== null && this.#load(), LIST_MS);
  }

  // The form that starts a map, and the list of maps.

  #side(facts) {
    const select = (options, onchange) => make("select", { onchange }, ...options.map(([text, value]) => make("option", { textContent: text, value })));
    const text = (placeholder) => make("input", { type: "text", placeholder });
    this.form = {
      domain: select([["hits", "time"], ["impedances", "frequency"]], () => this.#fields()),
      rig: select(facts.rigs.map((name) => [name, name])),
      hand: select(HANDS),
      schemes: make("textarea", { rows: 3, placeholder: "default: own and uniform; else one per line: dual:20k/2k", ariaLabel: "Schemes, one per line" }),
      damping: text("auto, or 0:3.6:17"),
      stiffness: text(""),
      way: select([["ladder", "ladder"], ["bisection", "bisection"], ["grid", "grid"]]),
      offsets: text("0.1,0.6"),
      repeats: make("input", { type: "number", min: 1, value: 1 }),
      changes: make("textarea", { rows: 2, placeholder: "key = value, one per line", ariaLabel: "Other settings, one per line" }),
    };
    this.detached = make("input", { type: "checkbox", checked: true });
    this.start = make("button", { type: "button", className: "first", textContent: "Start the map", onclick: () => this.#run() });
    this.end = make("button", { type: "button", textContent: "End this map", hidden: true, onclick: () => this.#ask("map-end") });
    this.busy = make("p", { className: "quiet", role: "status" });
    const labels = { domain: "of", rig: "rig", hand: "pushed by", schemes: "schemes", damping: "dampings B", stiffness: "stiffness K", way: "search", offsets: "zeros (count)", repeats: "repeats", changes: "settings" };
    this.rows = Object.fromEntries(Object.entries(labels).map(([name, label]) =>
      [name, make("label", { className: "field" }, make("span", { textContent: label }), this.form[name])]));
    return make("div", { className: "side" },
      make("section", { className: "panel" }, make("h2", { textContent: "Maps, including those made by commands" }), make("div", { className: "list" }, make("table", {}, this.list))),
      make("section", { className: "panel" }, make("h2", { textContent: "New map of a simulated rig" }), ...Object.values(this.rows),
        make("label", { className: "quiet", title: "the map is computed to its end even if this page closes" }, this.detached, " continue when this page closes"),
        make("p", {}, this.start), this.busy));
  }

  // The chosen domain determines which fields are enabled.
  #fields() {
    const domain = this.form.domain.value;
    for (const name of ["hand", "way", "offsets", "repeats"]) this.rows[name].hidden = domain === "frequency";
    this.form.stiffness.placeholder = domain === "time" ? "auto, or 10:1000" : "auto, or 500:30000:60";
    if (!this.touched && [...this.form.rig.options].some(({ value }) => value === DEFAULTS[domain])) this.form.rig.value = DEFAULTS[domain];
    this.form.rig.onchange = () => { this.touched = true; };
  }

  async #run() {
    const { domain, rig, hand, schemes, changes, damping, stiffness, way, offsets, repeats } = this.form;
    const lines = (area) => area.value.split("\n").map((line) => line.trim()).filter(Boolean);
    const pushed = domain.value === "frequency" ? {} : hand.value === "none" ? { "trial.kind": "constant-effort" } : { "trial.kind": "human", "operator.grip": hand.value };
    const content = { domain: domain.value, rig: rig.value, schemes: lines(schemes), damping: damping.value.trim(), stiffness: stiffness.value.trim(), is_detached: this.detached.checked,
      changes: { ...pushed, ...Object.fromEntries(lines(changes).map(setting)) } };
    if (domain.value === "time") Object.assign(content, { way: way.value, offsets: offsets.value.trim(), repeats: Number(repeats.value) || 1 });
    this.busy.textContent = "starting …";
    if (!(await this.#ask("map-run", content))) this.busy.textContent = "";
  }

  #state({ job, operated, operates }) {
    this.running = job === "map";
    this.start.disabled = job !== null || (operated && !operates);
    this.end.hidden = !(this.running && this.map !== null && this.map.name === this.made);
  }

  #job({ job, told: report }) {
    if (job !== "map") return;
    if (report.say === "mapping") {
      this.made = report.map;
      this.#watch(report.map);
    }
    const texts = { compiling: report.busy ? "compiling for this map, once per version and computer …" : "", mapping: "", done: "",
      failed: `The map failed: ${report.error}${report.remedy ? `; ${report.remedy}` : ""}` };
    if (report.say in texts) this.busy.textContent = texts[report.say];
    if (report.say === "ended") this.#load();
  }

  async #load() {
    const found = await this.link.ask("maps").catch(() => null);
    const now = JSON.stringify([found, this.map?.name]);
    if (found === null || now === this.listed) return; // what has the focus keeps it
    this.listed = now;
    const rows = found.map((map) => make("tr", {},
      make("td", {}, make("button", { type: "button", className: "name", textContent: map.name, disabled: map.problem !== null, ariaPressed: String(map.name === this.map?.name), onclick: () => this.#watch(map.name) })),
      make("td", { textContent: map.problem ?? `${map.state}${map.device ? ", on a device" : ""}` })));
    this.list.replaceChildren(...(rows.length ? rows : [make("tr", {}, make("td", { textContent: "no maps yet" }))]));
  }

  // One map.

  async #watch(name) {
    const facts = await this.#ask("map-watch", { map: name });
    if (!facts) return;
    const another = this.map?.name !== facts.name;
    this.map = facts;
    this.title.textContent = `${facts.rig}: ${facts.domain === "time" ? "which walls stay stable" : "which walls are passive"}`;
    this.plane.element.hidden = false;
    if (!another) return;
    if (this.late?.map === name) this.#take(this.late);
    this.plane.show(facts);
    this.scheme = 0;
    this.schemes.replaceChildren(...facts.schemes.map((scheme, number) => make("button", { type: "button", textContent: scheme.label, title: scheme.text,
      onclick: () => { this.scheme = number; this.#choose(); } })));
    this.#choose();
    this.#load();
    this.plane.theory = [];
    const curves = await this.#ask("map-theory", { map: name });
    if (this.map.name !== name || !curves) return;
    this.plane.theory = curves;
    this.plane.draw();
    this.#table();
  }

  #choose() {
    [...this.schemes.children].forEach((button, number) => { button.ariaPressed = String(number === this.scheme); });
    this.plane.choose(this.scheme);
    this.#table();
  }

  #take(report) {
    if (report.map !== this.map?.name) { // the map's description has not arrived yet
      this.late = report.anew ? report : this.late;
      return;
    }
    if (report.anew) this.columns = [];
    this.columns.push(...report.columns);
    this.plane.columns = this.columns;
    const cells = this.columns.reduce((sum, column) => sum + column.cells.length, 0);
    const left = report.state === "running" && report.left_s !== null ? `, about ${duration(report.left_s)} left` : "";
    const text = `${report.state}: ${report.done} of ${report.total} columns, ${cells} cells${left}`;
    if (this.progress.textContent !== text) this.progress.textContent = text;
    this.bar.hidden = report.state !== "running";
    this.bar.value = report.total ? report.done / report.total : 0;
    if (report.columns.length || report.anew) {
      this.plane.draw();
      this.#table();
    }
  }

  // The limits as a table, for users who cannot see the picture.
  #table() {
    if (this.map === null) return;
    const { dampings, units } = this.map;
    const curves = this.plane.theory.filter((curve) => curve.scheme === this.scheme);
    const head = [`B (${units.damping})`, `K up to (${units.stiffness})`, ...curves.map(({ name }) => name)];
    const rows = dampings.map((damping, number) => {
      const limits = this.columns.filter((column) => column.scheme === this.scheme && column.damping === number).map((column) => this.plane.limit(column));
      const [low, high] = [Math.min(...limits), Math.max(...limits)];
      const text = limits.length === 0 ? "–" : low === high ? written(low, 3) : `${written(low, 3)} to ${written(high, 3)}`;
      return make("tr", {}, make("th", { scope: "row", textContent: written(damping, 3) }), make("td", { textContent: text }),
        ...curves.map((curve) => make("td", { textContent: written(at(curve, damping), 3) })));
    });
    this.limits.replaceChildren(make("caption", { textContent: "Largest stiffness up to which all walls pass" }),
      make("thead", {}, make("tr", {}, ...head.map((text) => make("th", { scope: "col", textContent: text })))), make("tbody", {}, ...rows));
  }

  async #open({ key, stiffness }) {
    this.busy.textContent = this.map.device ? "" : "hitting that wall again …";
    const which = await this.#ask("map-hit", { map: this.map.name, key, stiffness });
    this.busy.textContent = "";
    if (which) this.open(which);
  }

  // Send a request; show an error as a notice and return null.
  #ask(what, content) {
    return this.link.ask(what, content).then((answer) => answer ?? true, (error) => {
      this.link.dispatchEvent(new CustomEvent("trouble", { detail: error }));
      return null;
    });
  }
}

// A line `key = value`: numbers and truths as such.
function setting(line) {
  const [key, ...rest] = line.split("=");
  const text = rest.join("=").trim().replace(/^"(.*)"$/, "$1");
  const value = text === "true" ? true : text === "false" ? false : text !== "" && Number.isFinite(Number(text)) ? Number(text) : text;
  return [key.trim(), value];
}

function at({ damping, stiffness }, wanted) {
  const place = damping.findIndex((one) => one >= wanted - 1e-12);
  if (place <= 0) return place === 0 ? stiffness[0] : stiffness.at(-1);
  const share = (wanted - damping[place - 1]) / (damping[place] - damping[place - 1]);
  return stiffness[place - 1] + share * (stiffness[place] - stiffness[place - 1]);
}

function duration(seconds) {
  if (seconds < 60) return `${Math.ceil(seconds)} s`;
  return seconds < 3600 ? `${Math.ceil(seconds / 60)} min` : `${(seconds / 3600).toFixed(1)} h`;
}
