// A rehearsal of the experiment of Koul et al. in three clicks: hits on ever stiffer walls, uniform and dual-rate.

import { make, written } from "../../../rig/extras/console/page/dom.js";

const RIG = "koul-compliant";
const DAMPING = 0.5;
const EFFORT = 0.4; // rests two counts deep in the stiffest wall, as a verdict asks
const WALLS = [50, 100, 200, 300, 400, 500, 600, 800, 1000];
const SCHEMES = [
  ["Uniform, 20 kHz", { "controller.position_rate": 20000, "controller.velocity_rate": 20000 }],
  ["Dual-rate, 20 and 2 kHz", { "controller.position_rate": 20000, "controller.velocity_rate": 2000 }],
];

export function rehearsal(rig) {
  const found = SCHEMES.map(() => []);
  const report = make("p", { className: "quiet", role: "status" });
  const missing = make("p", { className: "quiet", id: "missing-series" });
  const place = make("div");
  const compare = make("button", { type: "button", textContent: "3 Compare", "aria-describedby": missing.id, onclick: () => { report.textContent = comparison(); } });
  const buttons = SCHEMES.map(([name], i) => make("button", { type: "button", textContent: `${i + 1} ${name.split(",")[0]}`, onclick: () => run(i) }));

  // One series at a time: two would write into one table, and the module runs one hit.
  function enable(running) {
    const open = SCHEMES.filter((_, i) => found[i].length < WALLS.length).map(([name]) => name);
    for (const button of buttons) button.disabled = running;
    compare.disabled = running || open.length > 0;
    missing.textContent = running ? "The buttons wait for the end of this series." : open.length ? `To compare, first hit with: ${open.join("; ")}.` : "";
  }

  async function run(scheme) {
    const [name, changes] = SCHEMES[scheme];
    found[scheme] = [];
    enable(true);
    try {
      for (const stiffness of WALLS) {
        report.textContent = `${name}: hit on a wall of ${stiffness} N·m/rad …`;
        await new Promise((resolve) => setTimeout(resolve)); // the page stays alive between two hits
        const { kind, reasons, one } = rig.hit(RIG, { ...changes, "wall.stiffness": stiffness, "wall.damping": DAMPING, "trial.effort": EFFORT });
        found[scheme].push({ stiffness, kind, reasons, one });
        show();
      }
      report.textContent = `${name}: ${WALLS.length} hits.`;
    } catch (error) {
      report.textContent = `${name}: ${error.message}`;
    } finally {
      enable(false);
    }
  }

  function show() {
    const cell = (hit) => make("td", {}, ...(hit ? [make("span", { className: "verdict", dataset: { kind: hit.kind }, textContent: hit.kind }),
      ...(hit.reasons.length ? [make("span", { className: "quiet", textContent: ` ${hit.reasons.join("; ")}` })] : [])] : ["–"]));
    place.replaceChildren(make("table", { className: "ladder" },
      make("caption", { textContent: `${RIG}, B = ${DAMPING} N·m·s/rad, pushed with ${EFFORT} N·m` }),
      make("thead", {}, make("tr", {}, ...["K (N·m/rad)", ...SCHEMES.map(([name]) => name)].map((textContent) => make("th", { scope: "col", textContent })))),
      make("tbody", {}, ...WALLS.map((stiffness, i) => make("tr", {}, make("td", { textContent: stiffness }), ...found.map((hits) => cell(hits[i])))))));
  }

  function comparison() {
    const theory = (hits) => `linear theory: stable up to ${written(rig.limit(hits[0].one).stable, 3)} N·m/rad`;
    return SCHEMES.map(([name], i) => `${name}: ${summary(found[i])}; ${theory(found[i])}`).join(". ") + ".";
  }

  enable(false);
  return make("section", { className: "panel" }, make("h2", { textContent: "The experiment of the paper" }),
    make("p", { className: "quiet", textContent: "Does a slower velocity estimate allow a stiffer wall? Hit ever stiffer walls with both ways of sampling." }),
    make("p", { className: "steps" }, ...buttons, compare), missing, report, place);
}

// Up to which stiffness every wall is stable, and the verdict of the first that is not.
function summary(hits) {
  const first = hits.findIndex(({ kind }) => kind !== "stable");
  if (first < 0) return `every wall is stable, up to K = ${hits.at(-1).stiffness}`;
  const { stiffness, kind } = hits[first];
  return `${first ? `every wall is stable up to K = ${hits[first - 1].stiffness}, then` : "already"} K = ${stiffness}: ${kind}`;
}
