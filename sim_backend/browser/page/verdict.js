// The verdict of a hit from its numbers: rig.control.verdict. A page loses no samples and has no late ticks.

import { written } from "../../../rig/extras/console/page/dom.js";

const TOGGLES = 64;
const SATURATED = 4;
const SLEW_BOUND = 8;
const OUT_OF_WINDOW = 256;

const three = (value) => written(value, 3);
const times = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;
const percent = (share) => `${100 * share >= 10 ? Math.round(100 * share) : written(100 * share, 2)} %`;

// Kind and reasons of a trial, from its numbers and the thresholds of its experiment.
export function decide(n, limits, thrownOut = false) {
  const touched = n.contact_s >= 0;
  const felt = n.felt > limits.felt_velocity, heard = n.heard > limits.heard_effort, moved = n.moved > limits.moved;
  const exceeded = felt || heard || moved;
  const saturates = n.saturated_fraction_in_tail > limits.saturated_fraction;
  const exits = n.exits_in_tail > 0;
  const found = (list) => list.filter(([applies]) => applies).map(([, text]) => text);
  if (!(n.tail_begins_s >= 0)) return { kind: thrownOut && touched ? "unstable" : "invalid", reasons: [`only ${n.ticks} ticks in the trial`] };
  const invalid = found([
    [!touched, n.toggles < TOGGLES ? "the wall was never touched"
      : `the wall was never touched, and the count changed ${n.toggles} times between two neighbours`],
    [touched && n.inside_ticks_in_tail === 0, "the wall was not touched in the tail"],
    [n.inside_ticks_in_tail > 0 && n.contact_s > n.tail_begins_s, "the first contact lies in the tail"],
    [n.slew_bound_ticks > 0, `the slew limit acted in ${times(n.slew_bound_ticks, "tick")}`],
    [n.overruled_ticks > 0, `the device overruled the law in ${times(n.overruled_ticks, "tick")}`],
    [saturates && !exceeded, "saturated in the tail without ripple or motion"],
    [n.settling_in_tail_s > 0 && (exits || exceeded), `still settling when the tail began, ${three(n.settling_in_tail_s)} s too early: lengthen the trial`],
  ]);
  const ripples = found([
    [felt, `felt ${three(n.felt)} above ${three(limits.felt_velocity)}`],
    [heard, `heard ${three(n.heard)} above ${three(limits.heard_effort)}`],
    [moved, `moved ${three(n.moved)} above ${three(limits.moved)}`],
  ]);
  const unstable = found([
    [exits, `left the wall ${times(n.exits_in_tail, "time")} in the tail`],
    [n.growth > limits.growth && exceeded, `ripple grows ${three(n.growth)}-fold over the tail`],
    [saturates && exceeded, `saturates in ${percent(n.saturated_fraction_in_tail)} of the tail`],
  ]);
  if (thrownOut) return { kind: touched ? "unstable" : "invalid", reasons: ["a guard ended the run", ...unstable, ...ripples] };
  if (invalid.length) return { kind: "invalid", reasons: invalid };
  if (unstable.length) return { kind: "unstable", reasons: [...unstable, ...ripples] };
  return { kind: ripples.length ? "limit cycle" : "stable", reasons: ripples };
}

// The verdict of a hit from its rows, with the numbers of it; `fault`: what the device reported, if it did.
export function judge(module, one, rows, fault = "") {
  const { at, columns } = module;
  const { table: { resolution, effort_quantum: quantum, experiment: { wall }, meters, thresholds }, position: surface, rates } = one;
  const signals = [[], [], [], []];
  let thrownOut = false;
  for (let row = 0; row < rows.length; row += columns) {
    if (rows[row + at.flags] & OUT_OF_WINDOW) thrownOut = true;
    if (rows[row + at.phase] !== 3) continue;
    const position = resolution * rows[row + at.count];
    const flags = rows[row + at.flags];
    signals[0].push(position);
    signals[1].push(rows[row + at.current] * quantum);
    signals[2].push(wall.side * (position - surface));
    signals[3].push((flags & SATURATED ? 1 : 0) + (flags & SLEW_BOUND ? 2 : 0) + (rows[row + at.limits] & ~one.tables.warnings ? 4 : 0));
  }
  const numbers = module.measure(signals, meters[rates[0]]);
  const { kind, reasons } = decide(numbers, thresholds, thrownOut || fault !== "");
  return { kind, reasons, reason: [fault, ...reasons].filter(Boolean).join("; "), numbers };
}
