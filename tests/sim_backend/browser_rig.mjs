// The rig of a page, without the page.
import { readFileSync } from "node:fs";
import { Module } from "../../sim_backend/browser/page/module.js";
import { Rig } from "../../sim_backend/browser/page/rig.js";

// `script`: the page's script, `wall.js`.
export async function rigOf(script) {
  const { module, tables } = JSON.parse(readFileSync(script, "utf8").split("\n")[1].replace(/^.*?= |;$/g, ""));
  const compiled = await WebAssembly.compile(Buffer.from(module, "base64"));
  return new Rig(await Module.of(compiled, tables.layout), await Module.of(compiled, tables.layout), tables);
}
