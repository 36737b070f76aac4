// The velocity estimator of the next run and its settings: fields, and sliders where a range can be slid over. Names,
// ranges, units and defaults are those of the registry, a laboratory's own estimators among them.

import { make, written } from "./dom.js";

const STEPS = 1000; // of a slider
const DECADES = 100; // a range that is wider is slid over its logarithm
const WIDEST = 1000; // a range from zero that is wider is typed

export class Estimator {
  constructor(facts, changed) {
    this.known = Object.fromEntries(facts.estimators.map((one) => [one.name, one]));
    this.changed = changed;
    this.given = null; // until an experiment has come
    this.touched = {};
    this.select = make("select", { ariaLabel: "estimator", onchange: () => { this.#build(); changed(); } },
      ...facts.estimators.map(({ name, problem }) => make("option", { value: name, textContent: name, disabled: Boolean(problem), title: problem })));
    this.settings = make("div");
    this.problem = make("p", { className: "notice", role: "status" });
    this.element = make("div", {}, make("label", { className: "field" }, make("span", { textContent: "estimator" }), this.select), this.settings, this.problem);
  }

  // Show that of an experiment: what it sets, and the defaults of the rest.
  fill({ estimator, parameters }) {
    this.given = { estimator, parameters };
    this.select.value = estimator;
    this.#build();
  }

  choose(name) {
    this.select.value = name;
    this.#build();
  }

  // What was changed, by dotted key.
  get changes() {
    if (!this.given) return {};
    const settings = Object.entries(this.touched).map(([name, value]) => [`controller.parameters.${name}`, value]);
    const other = this.select.value === this.given.estimator ? [] : [["controller.estimator", this.select.value]];
    return Object.fromEntries([...other, ...settings]);
  }

  // Say what the server finds wrong with it; null: nothing.
  complain(error) {
    if (this.problem.textContent !== (error ?? "")) this.problem.textContent = error ?? "";
  }

  #build() {
    this.touched = {};
    this.complain(null);
    const set = this.select.value === this.given?.estimator ? this.given.parameters : {};
    this.settings.replaceChildren(...this.known[this.select.value].settings.map((one) => this.#field(one, set[one.name] ?? one.default)));
  }

  #field(setting, value) {
    const { name, meaning, unit, choices, of_rig: ofRig } = setting;
    const label = make("span", { textContent: name.replace(/_(hz|s)$/, "").replaceAll("_", " ") + (unit && unit !== "1" ? ` (${unit})` : "") });
    if (choices) {
      const select = make("select", { onchange: () => this.#set(name, select.value) }, ...choices.map((one) => make("option", { value: one, textContent: one })));
      select.value = value;
      return make("label", { className: "field", title: meaning }, label, select);
    }
    const { minimum, maximum } = setting;
    const say = () => range?.setAttribute("aria-valuetext", `${number.value} ${unit === "1" ? "" : unit}`.trim());
    const number = make("input", { type: "number", step: "any", min: minimum, max: maximum, value: value ?? "", placeholder: ofRig ? "of the rig" : "required", ariaLabel: name, onchange: () => {
      if (range) range.value = placeOf(setting, number.value);
      say();
      this.#set(name, Number(number.value));
    } });
    const range = slides(setting) ? make("input", { type: "range", min: 0, max: STEPS, value: placeOf(setting, value), ariaLabel: `${name}, slider`, oninput: () => {
      number.value = written(valueOf(setting, Number(range.value)), 3);
      say();
      this.#set(name, Number(number.value));
    } }) : null;
    say();
    return make("label", { className: "field", title: `${meaning}; ${written(minimum)} to ${written(maximum)} ${unit}` }, label, range, number);
  }

  #set(name, value) {
    this.touched[name] = value;
    this.changed();
  }
}

function slides({ minimum, maximum }) {
  return minimum > 0 || maximum - minimum <= WIDEST;
}

function logarithmic({ minimum, maximum }) {
  return minimum > 0 && maximum / minimum > DECADES;
}

function placeOf(setting, value) {
  const { minimum: low, maximum: high } = setting;
  const share = logarithmic(setting) ? Math.log(value / low) / Math.log(high / low) : (value - low) / (high - low);
  return Math.round(STEPS * share);
}

function valueOf(setting, place) {
  const { minimum: low, maximum: high } = setting;
  const share = place / STEPS;
  const value = logarithmic(setting) ? low * (high / low) ** share : low + (high - low) * share;
  return setting.whole ? Math.round(value) : value;
}
