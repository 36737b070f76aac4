// The verdict of a hit: rig.control.verdict, and rig.experiments.trials.judgement for a run that ended early. A page loses
// no samples and has no late ticks.

// A half goes to the even neighbour, as in Python: JavaScript rounds it up.
function halfToEven(value, digits) {
  const exact = value.toExponential(60).split("e")[0].replace(".", "");
  return /^50*$/.test(exact.slice(digits)) && exact[digits - 1] % 2 === 0 ? value * (1 - 2 ** -40) : value;
}

// Python's formats .2g and .3g. A number that is missing is in no reason.
function general(number, digits) {
  if (!Number.isFinite(number)) return "missing";
  const value = halfToEven(number, digits);
  const [mantissa, exponent] = value.toExponential(digits - 1).split("e");
  if (exponent >= -4 && exponent < digits) return String(Number(value.toPrecision(digits)));
  return `${Number(mantissa)}e${exponent[0]}${exponent.slice(1).padStart(2, "0")}`;
}

function percent(share) {
  const value = 100 * share;
  return `${share >= 0.1 ? halfToEven(value, value < 100 ? 2 : 3).toFixed(0) : general(value, 2)} %`;
}

const three = (value) => general(value, 3);
const times = (count, noun) => `${count} ${noun}${count === 1 ? "" : "s"}`;

// Kind and reasons of a trial, from its numbers and the thresholds of its experiment; `mostToggles` of a count in order.
export function decide(n, limits, mostToggles) {
  const touched = n.contact_s >= 0;
  const felt = n.felt > limits.felt_velocity, heard = n.heard > limits.heard_effort, moved = n.moved > limits.moved;
  const exceeded = felt || heard || moved;
  const saturates = n.saturated_fraction_in_tail > limits.saturated_fraction;
  const exits = n.exits_in_tail > 0;
  const found = (list) => list.filter(([applies]) => applies).map(([, text]) => text);
  if (!(n.tail_begins_s >= 0)) return { kind: "invalid", reasons: [`only ${n.ticks} ticks in the trial`] };
  const invalid = found([
    [!touched, n.toggles < mostToggles ? "the wall was never touched"
      : `the wall was never touched, and the count changed ${n.toggles} times between two neighbours: if the handle moved, one channel of the encoder is dead`],
    [touched && n.inside_ticks_in_tail === 0, "the wall was not touched in the tail"],
    [n.inside_ticks_in_tail > 0 && n.contact_s > n.tail_begins_s, "the first contact lies in the tail"],
    [n.slew_bound_ticks > 0, `the slew limit acted in ${times(n.slew_bound_ticks, "tick")}`],
    [n.overruled_ticks > 0, `the device overruled the law in ${times(n.overruled_ticks, "tick")}`],
    [saturates && !exceeded, "saturated in the tail without ripple or motion"],
    [n.settling_in_tail_s > 0 && (exits || exceeded), `still settling when the tail began, ${three(n.settling_in_tail_s)} s too early: lengthen the trial`],
  ]);
  if (invalid.length) return { kind: "invalid", reasons: invalid };
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
  if (unstable.length) return { kind: "unstable", reasons: [...unstable, ...ripples] };
  return { kind: ripples.length ? "limit cycle" : "stable", reasons: ripples };
}

// Kind and reason if the run ended before the push did; else null. `last`: flags of the last tick.
export function endedEarly({ fault, last, released, touched }, { flags, thrown_out: thrownOut }) {
  const left = (last & flags.OUT_OF_WINDOW) !== 0, lost = (last & flags.HOMING_FAILED) !== 0;
  if (released || !(fault || left || lost)) return null;
  if (touched && (fault ? thrownOut.faults.includes(fault) : left)) return { kind: "unstable", reason: thrownOut.out_of_window };
  return { kind: "invalid", reason: `the run ended early: ${fault ? "fault" : left ? "out of window" : "homing failed"}` };
}

// The signals of a hit, which grow with its rows.
export class Trial {
  constructor() {
    this.signals = [[], [], [], []];
    this.last = 0;
    this.released = false;
  }

  add(rows, { tables, table: { resolution, effort_quantum: quantum, experiment: { wall } }, position: surface }, { at, columns, mark }) {
    const { flags: { SATURATED, SLEW_BOUND }, phases } = tables;
    const trial = phases.indexOf("trial"), release = phases.indexOf("release");
    const [positions, efforts, penetrations, marks] = this.signals;
    for (let row = 0; row < rows.length; row += columns) {
      const phase = rows[row + at.phase];
      const flags = this.last = rows[row + at.flags];
      if (phase === release) this.released = true;
      if (phase !== trial) continue;
      const position = resolution * rows[row + at.count];
      positions.push(position);
      efforts.push(rows[row + at.current] * quantum);
      penetrations.push(wall.side * (position - surface));
      marks.push((flags & SATURATED && mark.saturated) + (flags & SLEW_BOUND && mark.slew_bound) + (rows[row + at.limits] & ~tables.warnings && mark.overruled));
    }
  }

  // The verdict with its numbers; `fault`: what the device latched, 0 without one.
  judge(module, { tables, table: { meters, thresholds }, rates }, fault) {
    const numbers = module.measure(this.signals, meters[rates[0]]);
    const found = decide(numbers, thresholds, tables.toggles);
    const early = endedEarly({ fault, last: this.last, released: this.released, touched: this.signals[2].some((depth) => depth > 0) }, tables);
    const { kind, reasons } = early ? { kind: early.kind, reasons: [early.reason, ...found.reasons] } : found;
    return { kind, reasons, reason: [fault ? tables.faults[fault] : "", ...reasons].filter(Boolean).join("; "), numbers };
  }
}
