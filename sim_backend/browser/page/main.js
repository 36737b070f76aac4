// A wall to touch: the console's scope, wall and handle, with a rig in this page in place of a server.

import { make, setText, written } from "../../../rig/extras/console/page/dom.js";
import { Handle } from "../../../rig/extras/console/page/handle.js";
import { Scope } from "../../../rig/extras/console/page/scope.js";
import { Sound } from "../../../rig/extras/console/page/sound.js";
import { notice, offerStop } from "../../../rig/extras/console/page/stop.js";
import { Wall } from "../../../rig/extras/console/page/wall.js";
import { changesOf, chosen, commandOf, fragmentOf, ofFragment } from "./choice.js";
import { Module } from "./module.js";
import { rehearsal } from "./rehearsal.js";
import { Rig } from "./rig.js";

const PRESETS = [
  ["Dual-rate, 20 and 2 kHz", "rig=koul-compliant"],
  ["No damping", "rig=koul-compliant&B=0"],
  ["Uniform, 20 kHz", "rig=koul-compliant&rates=20000/20000"],
  ["Uniform, 1 kHz", "rig=koul-compliant&rates=1000/1000"],
  ["Hapkit", "rig=hapkit"],
  ["SmartKnob", "rig=smartknob"],
  ["WoodenHaptics", "rig=woodenhaptics"],
];
const HOME = "koul-compliant";
const SETTLED_MS = 300;
const $ = (id) => document.getElementById(id);

// A wall in one place: how a push of the motor ends on it beside the limit of theory, the command that makes the same hit,
// and a link.
function sharing(rig) {
  const verdict = make("p", { role: "status", ariaLive: "polite" });
  const command = make("code", { className: "command" });
  const report = make("p", { className: "quiet", role: "status" });
  // Without a clipboard, as over plain HTTP, the text is shown to be selected.
  const copied = (text) => Promise.resolve(text).then((copy) => navigator.clipboard.writeText(copy))
    .then(() => setText(report, "Copied."), () => setText(report, text));
  const element = make("section", { className: "panel share" }, make("h2", { textContent: "This wall" }), verdict,
    make("p", { className: "quiet", textContent: "The same hit, row for row, with haptic-rig:" }), command,
    make("p", {}, make("button", { type: "button", textContent: "Copy the command", onclick: () => copied(command.textContent) }), " ",
      make("button", { type: "button", textContent: "Copy a link", onclick: () => copied(location.href) })), report);
  const show = (one) => {
    setText(command, commandOf(one));
    const { kind, reason } = rig.hit(one.rig, changesOf(one));
    const { stable } = rig.limit(one);
    const unit = rig.facts.units.stiffness[one.table.experiment.rig.motion];
    const theory = stable === null ? "no limit by linear theory" : `linear theory: stable up to ${written(stable, 3)} ${unit}`;
    verdict.replaceChildren("Pushed by the motor: ", make("span", { className: "verdict", dataset: { kind }, textContent: kind }), `; ${theory}`,
      ...(reason ? [make("span", { className: "quiet", textContent: ` (${reason})` })] : []));
  };
  return { element, show };
}

async function begin({ module, tables }) {
  const bytes = Uint8Array.from(atob(module), (character) => character.charCodeAt(0));
  const compiled = await WebAssembly.compile(bytes);
  const rig = new Rig(await Module.of(compiled, tables.layout), await Module.of(compiled, tables.layout), tables);
  rig.frames = (step) => requestAnimationFrame(step);
  offerStop(() => rig.stop());
  rig.addEventListener("trouble", ({ detail }) => notice(detail));
  rig.addEventListener("state", ({ detail: { loop } }) => setText($("state"), loop.ended !== null ? `ended: ${loop.ended}` : `${loop.phase}${loop.inside ? ", inside the wall" : ""}`));

  const scope = new Scope(rig, rig.facts);
  const handle = new Handle(rig, "Drag here, or use the arrow keys: left and right move the hand, up and down press.");
  const wall = new Wall(rig, rig.facts);
  const share = sharing(rig);
  const given = (fragment) => {
    const { rig: name = HOME, changes } = ofFragment(fragment);
    return { name, changes, fragment: fragmentOf(chosen(tables, name, changes)) };
  };
  const links = PRESETS.map(([textContent, fragment]) => make("a", { href: `#${given(fragment).fragment}`, textContent }));
  $("presets").append(...links);
  $("views").append(make("div", { className: "touch" },
    make("div", {}, handle.element, scope.element),
    make("div", {}, share.element, wall.element, new Sound(rig).element, rehearsal(rig))));

  let shown = null; // the fragment of the chosen wall
  let later = 0;
  const go = () => {
    try {
      const { name, changes, fragment } = given(location.hash);
      if (fragment === shown) return;
      rig.stop();
      wall.choose(name, changes);
    } catch (error) {
      notice(error);
    }
  };
  rig.addEventListener("chosen", ({ detail }) => {
    try {
      const one = rig.choose(detail);
      if (fragmentOf(one) === shown) return;
      shown = fragmentOf(one);
      for (const link of links) link.ariaCurrent = String(link.hash === `#${shown}`);
      clearTimeout(later);
      later = setTimeout(() => { // not while a slider moves
        location.replace(`#${shown}`);
        share.show(one);
      }, SETTLED_MS);
    } catch (error) {
      notice(error);
    }
  });
  addEventListener("hashchange", go);
  go();
  setText($("state"), "at rest");
}

begin(globalThis.wallData).catch((error) => {
  setText($("state"), "");
  notice(new Error(`This page could not start: ${error.message}. It needs a browser with WebAssembly.`));
});
