// Make hits as the page does. Arguments: the page's script, and a directory for the columns of each hit that a recording has
// too. Requests come as JSON on the standard input; each is answered by a line of JSON.
import { readFileSync, writeFileSync } from "node:fs";
import { rigOf } from "./browser_rig.mjs";

const COLUMNS = ["count", "active", "position_true", "velocity_true", "effort_true", "handle", "handle_velocity", "current", "phase"];
const [, , data, directory] = process.argv;

const rig = await rigOf(data);
JSON.parse(readFileSync(0)).forEach(({ name, changes, place, offset }, number) => {
  for (const setup of Object.values(rig.tables.rigs[name].setups)) setup[place] = offset; // of position zero in its encoder cell
  try {
    const { one, rows, fault, kind, reasons, numbers } = rig.hit(name, changes);
    const { at, columns } = rig.other;
    const values = COLUMNS.map((column) => rows.filter((_, i) => i % columns === at[column]));
    writeFileSync(`${directory}/${number}`, Buffer.concat(values.map((column) => Buffer.from(column.buffer))));
    console.log(JSON.stringify({ kind, reasons, numbers, fault, effort: one.effort }));
  } catch (error) {
    if (error instanceof TypeError) throw error; // a defect of the page
    console.log(JSON.stringify({ refused: error.message }));
  }
});
