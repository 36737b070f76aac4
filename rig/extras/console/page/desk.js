// The question of a session and its answer by buttons, by their keys, or as text; for the operator and the participant.

import { make, setText } from "./dom.js";

const MOST_BUTTONS = 11; // of a scale: a longer one is typed

// A key as a protocol names it.
export function nameOf(key) {
  return key === " " ? "space" : key.length > 1 ? key.replace(/^Arrow/, "").toLowerCase() : key;
}

export class Answering {
  constructor(link, { participant }) {
    this.link = link;
    this.participant = participant;
    this.asked = 0;
    this.shown = 0;
    this.question = make("p", { className: "question", role: "status", ariaLive: "assertive" });
    this.buttons = make("p", { className: "answers" });
    this.input = make("input", { type: "text", autocomplete: "off", maxLength: 500, ariaLabel: "Answer" });
    this.line = make("form", { className: "line", hidden: true, onsubmit: (event) => { event.preventDefault(); this.say(this.input.value); } },
      this.input, make("button", { type: "submit", textContent: "Done" }),
      participant ? null : make("button", { type: "button", textContent: "Not now", onclick: () => this.press("escape") }));
    this.notice = make("p", { className: "notice", role: "status" });
    this.element = make("div", { className: "answering" }, this.question, this.buttons, this.line, this.notice);
    this.input.addEventListener("keydown", (event) => this.#inLine(event));
  }

  // `report`: the number of the question, its text, the keys that answer it, the kind of text input, the item, a notice.
  show(report) {
    if (report.asked !== this.asked) {
      this.asked = report.asked;
      this.shown = performance.now();
      this.input.value = "";
    }
    this.moving = report.moving;
    setText(this.question, report.text);
    setText(this.notice, report.notice);
    this.#offer(report);
    const wanted = Boolean(report.entry);
    if (wanted === this.line.hidden) {
      this.line.hidden = !wanted;
      this.input.value = "";
      if (wanted) this.input.focus();
      else this.input.blur();
    }
    this.input.ariaLabel = report.entry === "note" ? "Note" : "Answer";
    this.input.placeholder = report.entry === "note" ? "a note for the log" : "";
  }

  press(key) {
    this.#say("session_key", { key });
  }

  say(text) {
    this.#say("session_line", { text });
    this.input.value = "";
  }

  #say(what, content) {
    const shown_s = (performance.now() - this.shown) / 1000;
    this.link.ask(what, { ...content, asked: this.asked, shown_s })
      .catch((error) => this.link.dispatchEvent(new CustomEvent("trouble", { detail: error })));
  }

  #offer({ offered, item, entry }) {
    const values = entry === "item" ? valuesOf(item) : [];
    const text = JSON.stringify([offered, values]);
    if (this.offered === text) return;
    this.offered = text;
    const focused = this.buttons.contains(document.activeElement);
    this.buttons.replaceChildren(
      ...values.map(([value, label]) => make("button", { type: "button", textContent: label, onclick: () => this.say(value) })),
      ...offered.filter(([key]) => key !== "enter").map(([key, name]) => make("button", { type: "button", ariaKeyShortcuts: key, onclick: () => this.press(key) }, make("kbd", { textContent: key }), ` ${name}`)));
    if (focused) document.activeElement?.blur(); // Space is STOP again
  }

  #inLine(event) {
    if (event.key === "Enter" && event.repeat) event.preventDefault(); // held from before, it would answer with nothing
    if (event.key === "Escape" && !this.participant) this.press("escape");
    if (event.key === " " && this.moving) {
      event.preventDefault();
      this.link.stop();
    }
  }
}

function valuesOf(item) {
  if (item?.kind === "choice") return item.choices.map((choice, i) => [choice, `${i + 1} ${choice}`]);
  if (item?.kind !== "scale" || item.highest - item.lowest >= MOST_BUTTONS) return [];
  return Array.from({ length: item.highest - item.lowest + 1 }, (_, i) => String(item.lowest + i)).map((value) => [value, value]);
}
