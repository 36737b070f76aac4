// Call parts of the page. Argument: the page's script. The part comes as JSON on the standard input, the answer is a line of
// JSON.
import { readFileSync } from "node:fs";
import { blockOf, chosen, setupOf } from "../../sim_backend/browser/page/choice.js";
import { Hand } from "../../sim_backend/browser/page/hand.js";
import { decide, endedEarly } from "../../sim_backend/browser/page/verdict.js";
import { rigOf } from "./browser_rig.mjs";

const TRIALS = 2000;
const rig = await rigOf(process.argv[2]);
const { tables } = rig;
const { part, content } = JSON.parse(readFileSync(0));

let draw = 1;
function random(values) { // the same in each run
  draw = (Math.imul(draw, 1664525) + 1013904223) >>> 0;
  return values[(draw >>> 16) % values.length];
}

const parts = {
  // Trials of random numbers about the thresholds, with their kinds and reasons.
  decide: (limits) => Array.from({ length: TRIALS }, () => {
    const scales = { felt: limits.felt_velocity, heard: limits.heard_effort, moved: limits.moved, growth: limits.growth, saturated_fraction_in_tail: 1 };
    const missing = ["felt", "contact_s", "tail_begins_s"];
    const numbers = Object.fromEntries(rig.other.numbers.map((name) => {
      const factor = random(missing.includes(name) ? [0.2, 0.2, 1.3157, NaN] : name.startsWith("saturated") ? [0, 0, 0.0925, 0.105, 0.115, 1] : [0, 0, 0, 0.2, 1.3157, 31.57]);
      const value = (scales[name] ?? 1) * factor;
      return [name, name in scales || name.endsWith("_s") ? value : Math.round(100 * value)];
    }));
    const { kind, reasons } = decide(numbers, limits, tables.toggles);
    return [numbers, kind, reasons];
  }),
  endedEarly: () => {
    const { OUT_OF_WINDOW, HOMING_FAILED } = tables.flags;
    const ends = [...Object.keys(tables.faults).map((fault) => [Number(fault), 0]), [0, OUT_OF_WINDOW], [0, HOMING_FAILED]];
    return ends.flatMap(([fault, last]) => [false, true].flatMap((released) => [false, true].map((touched) => {
      const run = { fault, last, released, touched };
      const early = endedEarly(run, tables);
      return [run, early && early.kind, early && early.reason];
    })));
  },
  // Where the hand of each rig ends when it is asked for much more.
  ends: () => Object.keys(tables.rigs).flatMap((name) => [-1e3, 1e3].map((position) => {
    const hand = new Hand(chosen(tables, name));
    hand.wish({ position });
    let script;
    for (let second = 0; second < 12; second++) script = hand.next(Math.round(1 / hand.tick_s));
    return [name, position, script.at(-3)];
  })),
  refused: () => {
    const one = chosen(tables, "koul-rigid");
    const { other } = rig;
    other.begin(setupOf(one, "hit"), blockOf(one, "hit"));
    other.run(one.rates[0] / 2); // rests in the wall
    const accepted = other.change(blockOf({ ...one, stiffness: 2 * one.stiffness }, "hit", true)) === 0;
    const waited = other.waits;
    other.change(Uint8Array.of(255, 255, 0, 0, 0, 0)); // no parameter
    return [accepted, waited, other.waits];
  },
};
console.log(JSON.stringify(parts[part](content)));
