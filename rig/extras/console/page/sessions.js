// Sessions: begin or resume one, and operate it: the state in large, the question with its keys, the state of the rig.
// All texts come from the server and are the terminal's; keys are sent to the server, as from a terminal.

import { Answering, nameOf } from "./desk.js";
import { make, setText } from "./dom.js";

const HANDS = [["moved by a script", "simulated"], ["dragged with the mouse", "mouse"], ["moved by arrow keys", "keyboard"]];
const COMPILING = "Compiling, once per version and computer …";
const CONTROLS = "input, select, textarea, [contenteditable]";

export class Sessions {
  constructor(link, { participants }) {
    this.link = link;
    this.screen = `participant.html#${participants}`;
    this.answering = new Answering(link, { participant: false });
    this.desk = make("div", { className: "desk", hidden: true }, ...this.#desk());
    this.starting = make("p", { className: "panel", role: "status", hidden: true, textContent: "The session starts …" });
    this.setup = make("div", { className: "setup" }, ...this.#setup());
    this.element = make("div", { className: "sessions" }, this.setup, this.starting, this.desk);
    link.addEventListener("session", ({ detail }) => this.#show(detail));
    link.addEventListener("state", ({ detail }) => { this.start.disabled = detail.job !== null || (detail.operated && !detail.operates); });
    addEventListener("keydown", (event) => this.#key(event));
    addEventListener("keyup", (event) => { if (event.key === " " && this.#isOurs(event)) event.preventDefault(); });
    this.#list();
  }

  // Before a session.

  #setup() {
    const text = (value = "", more = {}) => make("input", { type: "text", value, autocomplete: "off", spellcheck: false, ...more });
    const check = (label, title = "") => {
      const input = make("input", { type: "checkbox" });
      return { input, element: make("label", { className: "check", title }, input, ` ${label}`) };
    };
    this.protocol = text("", { required: true, placeholder: "a file, or a template" });
    this.protocols = make("datalist", { id: "protocols" });
    this.protocol.setAttribute("list", "protocols");
    this.about = make("p", { className: "quiet" });
    this.protocol.addEventListener("input", () => this.#about());
    this.code = text("", { placeholder: "P01" });
    this.who = make("select", { onchange: () => this.#who() }, make("option", { value: "person", textContent: "a participant" }), make("option", { value: "simulated", textContent: "a simulated person (rehearsal)" }));
    this.hand = make("select", {}, ...HANDS.map(([label, value]) => make("option", { value, textContent: label })));
    this.url = text("", { placeholder: "the simulated rig" });
    this.row = text("", { placeholder: "by the code's number", inputMode: "numeric" });
    this.thresholds = text("", { placeholder: "dual=430, uniform=150" });
    this.spread = text("", { placeholder: "15", inputMode: "decimal", title: "how gradually verdicts change over stiffness" });
    this.lapses = text("", { placeholder: "0", inputMode: "decimal", title: "share of inverted verdicts, as by pressing the wrong key" });
    this.peopleSd = text("", { placeholder: "0", inputMode: "decimal", title: "differences between simulated people: standard deviation of ln K50" });
    this.study = text("", { placeholder: "by the study's title", title: "directory of all participants" });
    this.at = make("select", {}, make("option", { value: "trial", textContent: "the next trial" }), make("option", { value: "block", textContent: "the block, from its beginning" }));
    this.otherDevice = check("on a different device than before", "as --other-device: the analysis reports it");
    this.lsl = check("stream samples and markers", "as --lsl: by Lab Streaming Layer");
    this.realtime = check("in real time");
    this.again = check("replace an existing rehearsal");
    this.otherProtocol = check("with a different protocol than earlier sessions", "as --other-protocol: the analysis then needs --across");
    this.armAnyway = check("arm walls that the arming gate refuses", "as --arm-anyway: consent for the whole session");
    this.lossyAnyway = check("begin even if this computer loses samples", "as --lossy-anyway");
    this.people = make("div", {}, field("handle", this.hand), field("device", this.url), this.armAnyway.element, this.lossyAnyway.element);
    this.rehearsal = make("div", { hidden: true }, field("K50", this.thresholds), field("spread", this.spread), field("lapse rate", this.lapses), field("people's sd", this.peopleSd), this.realtime.element, this.again.element);
    this.start = make("button", { type: "submit", className: "first", textContent: "Begin" });
    this.form = make("form", { onsubmit: (event) => { event.preventDefault(); this.#begin(); } },
      field("protocol", this.protocol), this.protocols, this.about, field("code", this.code), field("who", this.who),
      this.people, this.rehearsal, make("details", {}, make("summary", { textContent: "Order, place, streams" }), field("row", this.row), field("study", this.study), this.otherProtocol.element, this.lsl.element), make("p", {}, this.start));
    this.resumable = make("tbody");
    this.none = make("p", { className: "quiet", textContent: "No unfinished session in this directory." });
    this.resumes = make("div", { hidden: true }, field("continue with", this.at), this.otherDevice.element,
      make("p", { className: "quiet", textContent: "An interrupted session continues where it stopped, on the same device; consents and the handle's source are taken from the form beside." }));
    this.ended = make("section", { className: "panel", hidden: true, role: "status" });
    const table = make("table", {}, make("thead", {}, make("tr", {}, ...["who", "study", "trials", "left", ""].map((name) => make("th", { textContent: name, scope: "col" })))), this.resumable);
    return [make("section", { className: "panel begin" }, make("h2", { textContent: "Begin a session" }), this.form),
      make("div", {}, this.ended, make("section", { className: "panel" }, make("h2", { textContent: "Unfinished sessions" }), table, this.none,
        this.resumes))];
  }

  #who() {
    const simulated = this.who.value === "simulated";
    this.people.hidden = simulated;
    this.rehearsal.hidden = !simulated;
  }

  #about() {
    this.about.textContent = this.found?.find(({ name }) => name === this.protocol.value)?.about ?? "";
  }

  async #list() {
    try {
      const { protocols, resumable } = await this.link.ask("sessions");
      this.found = protocols;
      this.protocols.replaceChildren(...protocols.map(({ name, about }) => make("option", { value: name, label: about })));
      if (!this.protocol.value) this.protocol.value = protocols.find(({ name }) => name === "first-steps")?.name ?? "";
      this.#about();
      this.none.hidden = resumable.length > 0;
      this.resumes.hidden = resumable.length === 0;
      this.resumable.parentElement.hidden = resumable.length === 0;
      this.resumable.replaceChildren(...resumable.map((one) => make("tr", {}, ...[one.code, one.title + (one.rehearsal ? " (rehearsal)" : ""), String(one.trials), one.stopped].map((text) => make("td", { textContent: text })),
        make("td", {}, make("button", { type: "button", textContent: "Resume", ariaLabel: `Resume ${one.code}`, onclick: () => this.#ask({ directory: one.directory, at: this.at.value, other_device: this.otherDevice.input.checked }) })))));
    } catch (error) {
      this.#trouble(error);
    }
  }

  #begin() {
    const content = { protocol: this.protocol.value, code: this.code.value, study: this.study.value, other_protocol: this.otherProtocol.input.checked };
    if (this.row.value.trim()) content.row = Number(this.row.value);
    if (this.who.value === "simulated") {
      const thresholds = this.thresholds.value.split(",").map((one) => one.trim()).filter(Boolean);
      const given = { spread: this.spread, lapse_rate: this.lapses, people_sd: this.peopleSd };
      const numbers = Object.entries(given).filter(([, field]) => field.value.trim()).map(([name, field]) => [name, Number(field.value)]);
      content.person = { thresholds, ...Object.fromEntries(numbers) };
      Object.assign(content, { realtime: this.realtime.input.checked, again: this.again.input.checked });
    }
    this.#ask(content);
  }

  #ask(content) {
    const rig = { url: this.url.value, hand: this.hand.value, arm_anyway: this.armAnyway.input.checked, lossy_anyway: this.lossyAnyway.input.checked, lsl: this.lsl.input.checked };
    this.link.ask("session", { ...rig, ...content }).catch((error) => this.#trouble(error));
  }

  #trouble(error) {
    this.link.dispatchEvent(new CustomEvent("trouble", { detail: error }));
  }

  // The desk.

  #desk() {
    this.place = make("p", { className: "quiet place" });
    this.state = make("p", { className: "cue", role: "status", ariaLive: "assertive" });
    this.saying = make("p", { className: "saying" });
    this.last = make("p", { className: "last", role: "status" });
    this.facts = make("dl", { className: "pairs" });
    this.gauges = make("dl", { className: "pairs gauges" });
    this.heat = make("meter", { min: 0, max: 1, high: 0.8, ariaLabel: "Motor heat, share of its budget" });
    this.lines = make("ol", { className: "log" });
    this.keys = make("dl", { className: "pairs" });
    this.help = make("details", {}, make("summary", { textContent: "Keys (?)", onclick: (event) => { event.preventDefault(); this.answering.press("?"); } }), this.keys);
    this.way = new Way(this.link);
    const screen = make("a", { href: this.screen, target: "_blank", textContent: "Open the participant's screen" });
    const main = make("section", { className: "panel operator", ariaLabel: "Operator's desk" }, this.place, this.state, this.saying, this.answering.element, this.last, this.way.element);
    const side = make("div", { className: "side" },
      make("section", { className: "panel" }, make("h2", { textContent: "Now" }), this.facts, this.heat),
      make("section", { className: "panel" }, make("h2", { textContent: "Live" }), this.gauges),
      make("section", { className: "panel" }, make("h2", { textContent: "Log" }), this.lines),
      make("section", { className: "panel" }, this.help, make("p", { className: "quiet" }, screen)));
    return [main, side];
  }

  #show(report) {
    const runs = report.runs;
    if (this.runs && !runs) this.#list();
    this.runs = runs;
    this.report = report;
    this.setup.hidden = runs;
    this.desk.hidden = !runs || report.state === undefined;
    this.starting.hidden = !runs || !this.desk.hidden;
    setText(this.starting, report.compiling ? COMPILING : "The session is starting: measuring this computer and the link …");
    this.ended.hidden = !report.end || runs;
    if (report.end) this.ended.replaceChildren(make("h2", { textContent: report.end.over ? "The session is complete" : "The session was interrupted" }), make("p", { textContent: report.end.stands }), pairs(make("dl", { className: "pairs" }), report.end.pairs));
    if (!runs || report.state === undefined) return;
    setText(this.place, report.place);
    setText(this.state, report.state);
    this.state.dataset.moving = report.moving;
    setText(this.saying, report.saying ? `Say: ${report.saying}` : "");
    this.answering.show({ ...report, text: report.compiling && report.moving ? COMPILING : report.question });
    setText(this.last, report.last);
    pairs(this.facts, report.facts);
    this.heat.value = report.heat;
    pairs(this.gauges, report.gauges.map(([name, , text]) => [name, text]), report.gauges.map(([, share]) => share));
    if (this.lines.dataset.text !== report.lines.join("\n")) {
      this.lines.dataset.text = report.lines.join("\n");
      this.lines.replaceChildren(...report.lines.map((line) => make("li", { textContent: line })));
    }
    pairs(this.keys, report.keys);
    this.help.open = report.help;
    this.way.show(report);
    if (report.rings > (this.rings ?? report.rings)) ring();
    this.rings = report.rings;
  }

  // A key of the desk: not in a text field, where it is text, nor with Ctrl or Alt, which are the browser's.
  #key(event) {
    if (!this.#isOurs(event)) return;
    let key = nameOf(event.key);
    const leaves = this.report.entry || this.report.help || this.report.offered.some(([one]) => one === "escape");
    if (key === "escape" && !leaves) key = "space"; // STOP, which the page has sent already: the desk shows the result
    if (this.report.entry && key !== "escape") return;
    const button = event.target.closest("button");
    if (key === "enter" && button) { // presses it, once
      if (event.repeat) event.preventDefault();
      return;
    }
    event.preventDefault();
    if (key === "space" && button) this.link.stop(); // elsewhere the page has sent it already
    if (!event.repeat || this.way.moves(key)) this.answering.press(key);
  }

  #isOurs(event) {
    const shown = this.runs && !this.desk.hidden && this.element.offsetParent !== null;
    return shown && !event.ctrlKey && !event.altKey && !event.metaKey && event.key !== "Tab" && event.key !== "Shift" && !event.target.closest(CONTROLS);
  }
}

// The way of a simulated hand that is dragged: where it reaches from behind the start into the wall.
class Way {
  constructor(link) {
    this.link = link;
    this.strip = make("div", { className: "strip" }, make("span", { className: "behind" }), make("span", { className: "inside" }));
    this.knob = make("span", { className: "knob" });
    this.strip.append(this.knob);
    this.text = make("p", { className: "quiet" });
    this.element = make("div", { hidden: true }, this.strip, this.text);
    for (const kind of ["pointerdown", "pointermove", "pointerup"]) this.strip.addEventListener(kind, (event) => this.#to(event));
  }

  show({ hand, way, drags }) {
    this.element.hidden = way === null;
    if (way === null) return;
    const [share, start, wall] = way;
    this.drags = drags;
    setText(this.text, hand);
    this.strip.classList.toggle("drags", drags);
    this.strip.style.setProperty("--at-hand", share);
    this.strip.style.setProperty("--at-start", start);
    this.strip.style.setProperty("--at-wall", wall);
  }

  moves(key) {
    return !this.element.hidden && !this.drags && ["left", "right", "up", "down"].includes(key);
  }

  #to(event) {
    if (!this.drags) return;
    if (event.type === "pointerdown") this.strip.setPointerCapture(event.pointerId);
    const { left, width } = this.strip.getBoundingClientRect();
    const share = Math.min(1, Math.max(0, (event.clientX - left) / width));
    this.link.say("session_hand", { share, held: event.pointerType === "mouse" && event.buttons === 1 });
  }
}

function pairs(list, rows, shares = []) {
  const text = JSON.stringify([rows, shares]);
  if (list.dataset.text === text) return list;
  list.dataset.text = text;
  list.replaceChildren(...rows.flatMap(([name, value], i) => [make("dt", { textContent: name }),
    make("dd", {}, shares[i] === undefined || shares[i] === null ? null : make("meter", { min: 0, max: 1, high: 0.8, value: Math.min(1, shares[i]), ariaHidden: "true" }), value)]));
  return list;
}

function ring() {
  const context = new AudioContext();
  const tone = new OscillatorNode(context, { frequency: 880 });
  const volume = new GainNode(context, { gain: 0.1 });
  tone.connect(volume).connect(context.destination);
  tone.start();
  tone.stop(context.currentTime + 0.12);
  tone.addEventListener("ended", () => context.close());
}

function field(label, input) {
  return make("label", { className: "field" }, make("span", { textContent: label }), input);
}
