// A wall on a rig: what the fragment of a page's address, a parameter block and a command line say about it.

// The wall of a rig's own experiment, or with changes by dotted key; throws an error for rates that have no table.
export function chosen(tables, rig, changes = {}) {
  const table = tables.rigs[rig];
  if (!table) throw new Error(`rig ${rig} is not known: choose one of ${Object.keys(tables.rigs).join(", ")}`);
  const { wall, controller, trial, rig: { limits } } = table.experiment;
  const of = (key, own) => changes[key] ?? own;
  const one = {
    rig, table, tables,
    rates: [of("controller.position_rate", controller.position_rate), of("controller.velocity_rate", controller.velocity_rate)],
    estimator: of("controller.estimator", controller.estimator),
    stiffness: of("wall.stiffness", wall.stiffness), damping: of("wall.damping", wall.damping), position: of("wall.position", wall.position),
  };
  if (!table.changes[keyOf(one)]) {
    const rates = one.rates.map(kilo).join("/");
    throw new Error(`the estimator ${one.estimator} does not work at ${rates} Hz on ${rig}: choose other rates or another estimator`);
  }
  for (const name of ["stiffness", "damping", "position"]) {
    if (!Number.isFinite(one[name])) throw new Error(`wall.${name} = ${one[name]}: must be a number`);
  }
  if (!(one.stiffness > 0)) throw new Error(`wall.stiffness = ${one.stiffness}: must be above 0`);
  if (one.damping < 0) throw new Error(`wall.damping = ${one.damping}: must be at least 0`);
  if (wall.side * (one.position - trial.start) <= 0) throw new Error(`wall.position = ${one.position}: must lie beyond the start, ${trial.start}`);
  one.effort = effortFor(one, { ...trial, effort: of("trial.effort", trial.effort) }, wall.side);
  if (Math.abs(one.effort) > limits.effort) {
    throw new Error(`wall.stiffness = ${one.stiffness}: a push must rest ${trial.minimum_rest_counts} counts deep, for which the motor of ${rig} is too weak; choose a softer wall`);
  }
  return one;
}

// The push of a hit: the experiment's, or as much as rests deep enough for the encoder.
function effortFor({ stiffness, table }, { effort, minimum_rest_counts: counts }, side) {
  const needed = counts * Math.abs(table.resolution) * stiffness;
  if (side * effort >= needed) return effort;
  const digits = 10 ** (2 - Math.floor(Math.log10(needed)));
  return side * Number((Math.ceil(needed * digits * (1 + 1e-9)) / digits).toPrecision(4));
}

export function keyOf({ rates, estimator }) {
  return [...rates, estimator].join("|");
}

// All changes against the rig's own experiment, by dotted key.
export function changesOf(one) {
  const { wall, trial } = one.table.experiment;
  const changes = { ...one.table.changes[keyOf(one)] };
  for (const name of ["stiffness", "damping", "position"]) if (one[name] !== wall[name]) changes[`wall.${name}`] = one[name];
  if (one.effort !== trial.effort) changes["trial.effort"] = one.effort;
  return changes;
}

// The command that makes the same hit.
export function commandOf(one) {
  const { controller } = one.table.experiment;
  const own = { "controller.loop": ["--loop"], "wall.stiffness": ["-K"], "wall.damping": ["-B"], "trial.effort": ["--effort"] };
  const words = ["rig hit", "--rig", one.rig];
  const changes = changesOf(one);
  const { "controller.position_rate": t1, "controller.velocity_rate": t2, "controller.estimator": estimator, ...others } = changes;
  if (t1 !== controller.position_rate || t2 !== controller.velocity_rate) words.push("--rate", t1 === t2 ? kilo(t1) : `${kilo(t1)}/${kilo(t2)}`);
  if (estimator !== controller.estimator) words.push("--estimator", estimator);
  for (const [key, value] of Object.entries(others)) {
    const [table, ...names] = key.split(".");
    if (names.reduce((found, name) => found?.[name], one.table.experiment[table]) === value) continue;
    words.push(...(own[key] ? [...own[key], String(value)] : ["--set", `${key}=${value}`]));
  }
  return words.join(" ");
}

export function kilo(rate) {
  return rate % 1000 ? String(rate) : `${rate / 1000}k`;
}

// Fragment of an address, and back: rig, rates, estimator and wall.
export function fragmentOf(one) {
  const { rig, rates, estimator, stiffness, damping, position } = one;
  return `rig=${rig}&rates=${rates.join("/")}&estimator=${estimator}&K=${stiffness}&B=${damping}&wall=${position}`;
}

export function ofFragment(text) {
  const given = Object.fromEntries(new URLSearchParams(text.replace(/^#/, "")));
  const changes = {};
  const [t1, t2] = (given.rates ?? "").split("/").map(Number);
  if (t1 && (t2 ?? t1)) Object.assign(changes, { "controller.position_rate": t1, "controller.velocity_rate": t2 ?? t1 });
  if (given.estimator) changes["controller.estimator"] = given.estimator;
  const names = { K: "wall.stiffness", B: "wall.damping", wall: "wall.position" };
  for (const [name, key] of Object.entries(names)) if (given[name] !== undefined) changes[key] = Number(given[name]);
  return { rig: given.rig, changes };
}

// The parameters of the wall that a device with a law in float32 has: rig.control.on_device.float_wall.
function wallParameters({ table, rates: [t1, t2], stiffness, damping, position, effort }, kind) {
  const delta = Math.abs(table.resolution), quantum = table.effort_quantum;
  const period = 1 / t1 * Math.floor(t1 / t2);
  const surface = position / delta;
  return {
    float_surface: Math.floor(surface), float_surface_fraction: surface - Math.floor(surface),
    float_stiffness: stiffness * delta / quantum, float_damping: damping * delta / (period * quantum),
    ...(kind === "hit" ? { float_constant: effort / quantum } : {}),
  };
}

// The parameter block, as a host sends it (6 bytes an entry); `live`: only the wall, for a law that runs.
export function blockOf(one, kind, live = false) {
  const walls = wallParameters(one, kind);
  const bytes = Uint8Array.from(atob(one.table.blocks[`${kind}|${keyOf(one)}`]), (character) => character.charCodeAt(0));
  const view = new DataView(bytes.buffer);
  const kept = [];
  for (let at = 0; at < bytes.length; at += 6) {
    const name = one.tables.wall[view.getUint16(at, true)];
    if (name === "float_surface") view.setInt32(at + 2, walls[name], true);
    else if (name in walls) view.setFloat32(at + 2, walls[name] + 0, true); // one zero only
    if (!live || (name in walls && name !== "float_constant")) kept.push(...bytes.subarray(at, at + 6));
  }
  return Uint8Array.from(kept);
}

export function setupOf(one, kind) {
  return Float64Array.from(one.table.setups[`${kind}|${one.rates[0]}`]);
}
