// Recordings: a list with search; one of them in a scope, replayed, exported, or moved to the trash.

import { make, written } from "./dom.js";
import { Recorded } from "./recorded.js";
import { offer } from "./save.js";

const SEARCH_MS = 250;
const SEEN_AHEAD = "200px"; // of the list: pictures that are about to be scrolled into sight
const FORMS = [["CSV", "csv"], ["description of the CSV columns (JSON)", "json"], ["MAT", "mat"], ["Parquet", "parquet"]];

export class Recordings {
  constructor(link) {
    this.link = link;
    this.first = 0;
    this.chosen = null;
    this.search = make("input", { type: "search", placeholder: "search: unstable kalman K=100 …", ariaLabel: "Search recordings", oninput: () => this.#later() });
    this.trash = make("input", { type: "checkbox", onchange: () => this.#again() });
    this.rows = make("tbody");
    this.seen = new IntersectionObserver((found) => found.filter((one) => one.isIntersecting).forEach(({ target }) => this.#small(target)), { rootMargin: SEEN_AHEAD });
    this.note = make("p", { className: "quiet", role: "status" });
    this.more = make("button", { type: "button", textContent: "More", hidden: true, onclick: () => this.#load() });
    this.recorded = new Recorded(link, (error) => this.#trouble(error), () => this.#again());
    this.title = make("h2", { textContent: "Choose a recording" });
    this.settings = make("p", { className: "quiet" });
    this.picture = make("img", { className: "picture", alt: "Picture of the recording", hidden: true });
    this.draw = make("button", { type: "button", textContent: "Picture", onclick: () => this.#picture() });
    this.form = make("select", { ariaLabel: "Export as", onchange: () => this.#export() }, make("option", { value: "", textContent: "Export …" }),
      ...FORMS.map(([textContent, value]) => make("option", { value, textContent })));
    this.away = make("button", { type: "button", textContent: "Move to trash", onclick: () => this.#move() });
    this.actions = make("div", { className: "bar", hidden: true }, this.draw, this.form, this.away);
    this.element = make("div", {},
      make("div", { className: "found" }, make("section", { className: "panel" }, this.search,
        make("label", { className: "quiet" }, this.trash, " show the trash"), this.note,
        make("table", {}, make("thead", {}, make("tr", {}, ...["verdict", "recording", "wall and scheme"].map((textContent) => make("th", { scope: "col", textContent })))), this.rows), this.more)),
      make("section", { className: "scope", ariaLabel: "Recording" }, this.title, this.settings, this.actions, this.recorded.element, this.picture));
    link.addEventListener("job", ({ detail }) => { if (detail.told.say === "ended" && this.element.isConnected) this.#again(); });
  }

  // Its element, when it is first shown: before that, nothing is read.
  begin() {
    this.#again();
    return this.element;
  }

  // Show one, by its name, and its map where that has recordings of its own.
  async open(which) {
    if (!which.map && ![...this.rows.children].some((row) => row.dataset.name === which.name)) this.#again(); // it is new
    try {
      const facts = await this.link.ask("recording", { name: which.name, map: which.map ?? "" });
      this.chosen = facts;
      this.title.textContent = facts.name;
      this.settings.replaceChildren(...settings(facts));
      this.actions.hidden = false;
      this.picture.hidden = true;
      this.away.disabled = facts.map !== "";
      this.#mark();
      await this.recorded.show(facts);
    } catch (error) {
      this.#trouble(error);
    }
  }

  // The list.

  #later() {
    clearTimeout(this.waiting);
    this.waiting = setTimeout(() => this.#again(), SEARCH_MS);
  }

  #again() {
    this.first = 0;
    this.#load();
  }

  async #load() {
    const asked = { search: this.search.value, first: this.first, trash: this.trash.checked };
    this.number = (this.number ?? 0) + 1;
    const number = this.number;
    try {
      const { recordings, more, directory } = await this.link.ask("recordings", asked);
      if (number !== this.number) return; // another was asked for meanwhile
      const rows = recordings.map((one) => this.#row(one));
      if (asked.first === 0) {
        this.seen.disconnect();
        this.rows.replaceChildren(...rows);
      } else this.rows.append(...rows);
      for (const image of rows.flatMap((row) => [...row.querySelectorAll("img")])) this.seen.observe(image);
      this.first = asked.first + recordings.length;
      this.more.hidden = !more;
      this.note.textContent = this.first ? `${this.first}${more ? " and more" : ""} in ${directory}` : `no recordings in ${directory}`;
      this.#mark();
    } catch (error) {
      this.#trouble(error);
    }
  }

  #row(one) {
    const kind = one.problem ? "unreadable" : one.kind ?? one.ended ?? "not finished";
    const show = one.problem === null && !this.trash.checked;
    const name = make("button", { type: "button", className: "name", textContent: one.name.replace(/\.(parquet|rigcap)$/, ""), disabled: !show, onclick: () => this.open({ name: one.name }) });
    const back = this.trash.checked && make("button", { type: "button", textContent: "Restore", onclick: () => this.#restore(one.name) });
    const when = one.created ? new Date(one.created).toLocaleString([], { dateStyle: "short", timeStyle: "short" }) : "";
    return make("tr", { dataset: { name: one.name } },
      make("td", {}, make("span", { className: "verdict", dataset: { kind }, textContent: kind.replaceAll("_", " ") })),
      make("td", {}, name, make("div", { className: "quiet", textContent: when }), this.#place(one, show), ...(back ? [back] : [])),
      make("td", { textContent: one.problem ?? `K ${written(one.stiffness)}, B ${written(one.damping)}, ${scheme(one)}` }));
  }

  // The element for the picture of a recording, loaded once it is in sight; null without a picture.
  #place({ name, picture }, show) {
    return picture && show ? make("img", { alt: "", dataset: { name } }) : null;
  }

  async #small(image) {
    this.seen.unobserve(image);
    const blob = await this.link.fetch(`/recordings/${encodeURIComponent(image.dataset.name)}/picture`).catch(() => null); // it was moved or deleted meanwhile
    if (blob === null || !image.isConnected) return;
    image.onload = () => URL.revokeObjectURL(image.src);
    image.src = URL.createObjectURL(blob);
  }

  #mark() {
    for (const row of this.rows.children) row.classList.toggle("chosen", row.dataset.name === this.chosen?.name);
  }

  // What is done with one.

  #path(what) {
    const { name, map } = this.chosen;
    const [path, query = ""] = what.split("?");
    return `/recordings/${encodeURIComponent(name)}/${path}?${[query, map && `map=${encodeURIComponent(map)}`].filter(Boolean).join("&")}`;
  }

  async #picture() {
    const asked = this.chosen;
    this.draw.disabled = true;
    try {
      const blob = await this.link.fetch(this.#path("picture?draw=1"));
      if (this.chosen !== asked) return;
      if (!this.rows.querySelector("tr.chosen img")) this.#again(); // it has been drawn
      URL.revokeObjectURL(this.picture.src);
      this.picture.src = URL.createObjectURL(blob);
      this.picture.hidden = false;
      this.picture.onload = () => this.picture.scrollIntoView({ behavior: "smooth", block: "nearest" });
    } catch (error) {
      this.#trouble(error);
    } finally {
      this.draw.disabled = false;
    }
  }

  async #export() {
    const form = this.form.value;
    this.form.value = "";
    if (!form) return;
    try {
      const stem = this.chosen.name.replace(/\.[^.]*$/, "");
      offer(await this.link.fetch(this.#path(`export?form=${form}`)), form === "json" ? `${stem}.csv.json` : `${stem}.${form}`);
    } catch (error) {
      this.#trouble(error);
    }
  }

  async #move() {
    try {
      await this.link.ask("throw-away", { name: this.chosen.name });
      this.title.textContent = `${this.chosen.name} is in the trash`;
      this.chosen = null;
      this.actions.hidden = true;
      this.picture.hidden = true;
      this.settings.replaceChildren();
      this.recorded.clear();
    } catch (error) {
      this.#trouble(error);
    }
    this.#again();
  }

  async #restore(name) {
    await this.link.ask("restore", { name }).catch((error) => this.#trouble(error));
    this.#again();
  }

  #trouble(error) {
    this.link.dispatchEvent(new CustomEvent("trouble", { detail: error }));
  }
}

function wall({ stiffness, damping, units }) {
  return `K ${written(stiffness)} ${units.stiffness}, B ${written(damping)} ${units.damping}`;
}

function scheme({ position_rate: fast, velocity_rate: slow, estimator }) {
  const rates = fast === slow ? `${written(fast / 1000)}` : `${written(fast / 1000)}/${written(slow / 1000)}`;
  return `${rates} kHz, ${estimator}`;
}

function settings(facts) {
  const kind = facts.kind ?? facts.ended ?? "not finished";
  const from = facts.cut ? ` A cut from ${facts.cut.recording}, ${written(facts.cut.first_s)} to ${written(facts.cut.last_s)} s.` : "";
  const lost = facts.lost.length ? ` ${facts.lost.join("; ")}.` : "";
  return [make("span", { className: "verdict", dataset: { kind }, textContent: kind }), facts.reasons.length ? `: ${facts.reasons.join("; ")}. ` : ". ",
    `${facts.rig}, ${facts.trial}, ${wall(facts)}, ${scheme(facts)}; ${facts.rows} rows in ${written(facts.length_s)} s from ${facts.url}.${from}${facts.complete ? "" : " It is incomplete."}${lost}`];
}
