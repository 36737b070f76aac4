// What the wall of the documents' first page costs: bytes of the page, and processor time for a simulated second of each
// rig, with the rows that a scope draws. `python -m sim_backend.browser DIRECTORY`, then
// `node tests/benchmarks/wall_page.mjs DIRECTORY`.
import { readFileSync, readdirSync, statSync } from "node:fs";
import { performance } from "node:perf_hooks";
import { Module } from "../../sim_backend/browser/page/module.js";
import { Rig } from "../../sim_backend/browser/page/rig.js";

const MOST_BYTES = 1 << 20;
const FRAMES = 60; // a second
const directory = process.argv[2];

const bytes = readdirSync(directory).reduce((sum, name) => sum + statSync(`${directory}/${name}`).size, 0);
const { module, tables } = JSON.parse(readFileSync(`${directory}/wall.js`, "utf8").split("\n")[1].replace(/^.*?= |;$/g, ""));
const code = Buffer.from(module, "base64");
console.log(`page ${bytes} bytes (at most ${MOST_BYTES}), of these the module ${code.length}`);

const compiled = await WebAssembly.compile(code);
const rig = new Rig(await Module.of(compiled, tables.layout), await Module.of(compiled, tables.layout), tables);
let worst = 0;
for (const name of Object.keys(tables.rigs)) {
  const { position_rate: rate } = tables.rigs[name].experiment.controller;
  await rig.ask("show", { columns: ["position", "velocity", "effort_sent", "effort_applied", "penetration"], window_s: 2, trigger: null, paused: false });
  await rig.ask("run", { job: "play", rig: name, changes: {} });
  const spent = [];
  let now = performance.now();
  for (let second = 0; second < 5; second++) {
    const begun = process.cpuUsage();
    for (let frame = 0; frame < FRAMES; frame++) {
      rig.say("hand", { position: tables.rigs[name].experiment.wall.position + 0.01 * Math.sin(frame / 10), press: 2 });
      rig.step(now += 1000 / FRAMES);
    }
    const { user, system } = process.cpuUsage(begun);
    spent.push((user + system) / 1e6);
  }
  if (!rig.run) throw new Error(`${name}: ${rig.ended}`);
  rig.stop();
  const least = Math.min(...spent);
  worst = Math.max(worst, least);
  console.log(`${name} at ${rate} Hz: ${(1000 * least).toFixed(1)} ms of processor time a simulated second, ${(1000 * least / FRAMES).toFixed(2)} ms a frame`);
}
process.exitCode = bytes <= MOST_BYTES && worst < 0.5 ? 0 : 1; // half of a core is left to draw
