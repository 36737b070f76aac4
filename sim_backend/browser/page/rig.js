// A rig in this page, in place of the console's server: the same requests and messages as link.js, with the same answers.

import { blockOf, changesOf, chosen, fragmentOf, keyOf, setupOf } from "./choice.js";
import { Hand } from "./hand.js";
import { Rows, View } from "./rows.js";
import { Trial } from "./verdict.js";

const MOST_FRAME_S = 0.05; // simulated at once: a page that was hidden continues where it was
const STATE_MS = 100;
const MOTION_S = 0.002; // between two true states that are shown

export class Rig extends EventTarget {
  // `module` runs what is drawn, `other` whole hits beside it.
  constructor(module, other, tables) {
    super();
    Object.assign(this, { module, other, tables, names: tables.columns.map(({ name }) => name), began: 0, shown: null, run: null });
  }

  get facts() {
    const { columns, units, rigs, estimators } = this.tables;
    return { columns, units, rigs: Object.keys(rigs), estimators: estimators.map((name) => ({ name, settings: [], problem: "" })), simulated: true };
  }

  async ask(what, content = {}) {
    const answer = { experiment: this.#experiment, regions: this.#regions, run: this.#start, set: this.#set, show: this.#show, zoom: this.#zoom }[what];
    if (!answer) throw new Error(`${what}: a page without a server cannot do that`);
    return answer.call(this, content);
  }

  say(what, content) {
    if (what !== "hand") return;
    if (!this.run && this.last) {
      try {
        this.#start({ job: "play", ...this.last });
      } catch (error) {
        this.#send("trouble", error);
      }
    }
    this.run?.hand?.wish(content);
  }

  stop() {
    if (this.run) this.#end("stopped");
  }

  // The wall that is chosen, without a run; where it is drawn changes at once.
  choose({ rig, changes }) {
    const one = chosen(this.tables, rig, changes);
    this.last = { rig, changes };
    const same = this.run && this.run.one.rig === rig && keyOf(this.run.one) === keyOf(one);
    if (this.run?.job === "play" && !same) this.stop(); // the next touch begins with the new rates
    if (!this.run && !(this.one && fragmentOf(this.one) === fragmentOf(one))) {
      this.one = one;
      this.#sendLoop();
    }
    return one;
  }

  #send(name, detail) {
    this.dispatchEvent(new CustomEvent(name, { detail }));
  }

  #sendJob(job, report) {
    this.#send("job", { job, told: report });
  }

  #experiment({ rig }) {
    const { experiment, changes } = chosen(this.tables, rig).table;
    const rates = new Set(Object.keys(changes).map((key) => key.split("|").slice(0, 2).join("|")));
    return { ...experiment, rates: [...rates].map((key) => key.split("|").map(Number)) };
  }

  #regions({ rig, damping, changes }) {
    return { passive: null, hand: "no hand", ...this.limit(chosen(this.tables, rig, { ...changes, "wall.damping": damping })) };
  }

  #start({ job, rig, changes = {} }) {
    if (this.run?.job === "play") this.stop();
    if (this.run) throw new Error("a hit is running: wait for its end, or stop it");
    const one = this.one = chosen(this.tables, rig, changes);
    this.last = { rig, changes };
    begin(this.module, one, job);
    this.began++;
    this.run = { job, one, hand: job === "play" ? new Hand(one) : null, trial: new Trial(), set: 0, sets: 0, ticks: 0, owed: 0, state: 0 };
    this.rows = new Rows(this.names, one.rates[0]);
    this.view = this.shown && new View(this.rows, this.shown);
    this.#sendJob(job, { say: "started" });
    this.#sendLoop();
    this.last_ms = null;
    this.frames?.(() => this.step());
    return {};
  }

  // Simulate the time since the last frame.
  step(now_ms = performance.now()) {
    const { run } = this;
    if (!run) return;
    const elapsed_s = this.last_ms === null ? 1 / 60 : (now_ms - this.last_ms) / 1000;
    this.last_ms = now_ms;
    run.owed += Math.min(elapsed_s, MOST_FRAME_S) * run.one.rates[0];
    const ticks = Math.floor(run.owed);
    run.owed -= ticks;
    if (ticks > 0) this.#advance(ticks);
    if (this.run) {
      if (now_ms - run.state >= STATE_MS) {
        run.state = now_ms;
        this.#sendState();
      }
      this.frames?.(() => this.step());
    }
  }

  #advance(ticks) {
    const { run, module } = this;
    const rows = module.run(ticks, run.hand ? run.hand.next(ticks) : undefined);
    if (run.job === "hit") run.trial.add(rows, run.one, module);
    this.#take(rows);
    if (run.sets && !module.waits) run.set = run.sets;
    if (module.fault) this.#end(`device fault: ${this.tables.faults[module.fault] ?? module.fault}`, module.fault);
    else if (run.phase === this.tables.phases.indexOf("done")) this.#end("finished");
  }

  #take(rows) {
    const { run, module: { at, columns } } = this;
    const { one, hand } = run;
    const { resolution, effort_quantum: quantum, experiment: { wall } } = one.table;
    const [t1, t2] = one.rates;
    const speed = resolution * t1 / Math.floor(t1 / t2); // a count in a velocity period
    const every = Math.max(1, Math.round(MOTION_S * t1));
    const motions = [];
    for (let row = 0; row < rows.length; row += columns) {
      const position = resolution * rows[row + at.count];
      this.rows.add({
        position, velocity: rows[row + at.velocity] * speed, penetration: wall.side * (position - one.position),
        effort_sent: rows[row + at.current] * quantum, effort_applied: rows[row + at.active] * quantum,
      });
      if (run.ticks++ % every === 0) motions.push([run.ticks / t1, hand ? rows[row + at.hand] : null, rows[row + at.handle], rows[row + at.handle_velocity]]);
    }
    const last = rows.length - columns;
    run.phase = rows[last + at.phase];
    run.inside = (rows[last + at.flags] & this.tables.flags.INSIDE) !== 0;
    this.#sendFrame();
    if (motions.length) this.#send("hand", { motions });
  }

  #sendFrame() {
    const frame = !this.shown?.paused && this.view?.frame();
    if (frame) this.#send("frame", frame);
  }

  #end(reason, fault = 0) {
    const { run } = this;
    this.run = null;
    this.ended = reason;
    const { job, one } = run;
    if (job === "hit" && reason !== "stopped") {
      this.#sendJob(job, { say: "done", result: [{ ...one, verdict: run.trial.judge(this.module, one, fault), recording: "" }] });
    }
    this.#sendJob(job, { say: "ended" });
    this.#sendState(run);
  }

  // A whole hit at once, without drawing it; its rows are overwritten by the next one.
  hit(rig, changes) {
    const one = chosen(this.tables, rig, changes);
    begin(this.other, one, "hit");
    const rows = this.other.run(this.other.mostRows);
    const { fault } = this.other;
    const trial = new Trial();
    trial.add(rows, one, this.other);
    return { one, rows, fault, ...trial.judge(this.other, one, fault) };
  }

  // The largest stable stiffness by linear theory, and what that covers; null where theory has no model.
  limit({ table, rates, estimator, damping }) {
    const { dampings, limits } = table;
    const own = limits[[...rates, estimator].join("|")];
    if (!own?.length) return { stable: null, note: `linear theory has no model of ${estimator}` };
    const last = dampings.at(-1);
    const place = Math.min(damping / last, 1) * (dampings.length - 1);
    const low = Math.min(Math.floor(place), dampings.length - 2);
    const beyond = damping > last ? `, which end at B = ${last}` : "";
    return { stable: own[low] + (place - low) * (own[low + 1] - own[low]), note: `interpolated between ${dampings.length} computed dampings${beyond}` };
  }

  #set({ changes }) {
    const { run } = this;
    if (!run) throw new Error("no wall is running");
    const one = chosen(this.tables, run.one.rig, { ...changesOf(run.one), ...changes });
    if (this.module.change(blockOf(one, run.job, true))) throw new Error("the device refuses this wall");
    run.one = this.one = one;
    run.sets++;
    this.#sendLoop();
    return { number: run.sets };
  }

  #show(shown) {
    this.shown = shown;
    this.view = this.rows && new View(this.rows, shown);
    this.#sendFrame();
    return {};
  }

  #zoom({ columns, first_s, last_s }) {
    if (!this.rows) throw new Error("there is no run");
    const { rate } = this.rows;
    const [first, last] = [Math.max(0, Math.floor(first_s * rate)), Math.ceil(last_s * rate)];
    const step = Math.max(1, Math.floor((last - first) / 1000));
    this.#send("frame", this.rows.cut(columns.filter((name) => this.names.includes(name)), first, last, step, { kind: "zoom", fresh: true }));
    return {};
  }

  #sendLoop() {
    const { one } = this;
    const { experiment } = one.table;
    const wall = { ...experiment.wall, stiffness: one.stiffness, damping: one.damping, position: one.position };
    this.#send("loop", { pid: 1, since: this.began, rate: one.rates[0], experiment: { ...experiment, wall }, gate: { delay_ticks: 0 } });
  }

  #sendState(ended = null) {
    const run = ended ?? this.run;
    const loop = { phase: this.tables.phases[run.phase ?? 0], inside: run.inside ?? false, set: run.set, ended: ended && this.ended, counters: { lost: 0, skipped: 0 }, fault: "none" };
    this.#send("state", { loop, operates: true, operated: true, job: !ended && run.job === "hit" ? "hit" : null, blinded: false });
  }
}

function begin(module, one, kind) {
  const refused = module.begin(setupOf(one, kind), blockOf(one, kind));
  if (refused) throw new Error(`the device refuses these parameters (status ${refused >> 16}, parameter ${refused & 0xffff})`);
}
