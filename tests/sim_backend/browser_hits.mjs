// Make hits as the page does. Arguments: the page's script, and a directory for the columns of each hit that a recording has
// too. Requests come as JSON on the standard input; each is answered by a line of JSON.
import { readFileSync, writeFileSync } from "node:fs";
import { Module } from "../../sim_backend/browser/page/module.js";
import { Rig } from "../../sim_backend/browser/page/rig.js";

const COLUMNS = ["count", "active", "position_true", "velocity_true", "effort_true", "handle", "handle_velocity"];
const [, , data, directory] = process.argv;

const { module, tables } = JSON.parse(readFileSync(data, "utf8").split("\n")[1].replace(/^.*?= |;$/g, ""));
const rig = new Rig(null, await Module.of(Buffer.from(module, "base64"), tables.layout), tables);
JSON.parse(readFileSync(0)).forEach(({ name, changes, place, offset }, number) => {
  for (const setup of Object.values(tables.rigs[name].setups)) setup[place] = offset; // of position zero in its encoder cell
  try {
    const { one, rows, kind, fault } = rig.hit(name, changes);
    const { at, columns } = rig.other;
    const values = COLUMNS.map((column) => rows.filter((_, i) => i % columns === at[column]));
    writeFileSync(`${directory}/${number}`, Buffer.concat(values.map((column) => Buffer.from(column.buffer))));
    console.log(JSON.stringify({ kind, fault, effort: one.effort }));
  } catch (error) {
    console.log(JSON.stringify({ refused: error.message }));
  }
});
