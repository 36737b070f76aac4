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
  const found = SCHEMES.map(() => null);
  const report = make("p", { className: "quiet", role: "status" });
  const place = make("div");
  const conclude = make("button", { type: "button", textContent: "3 Compare", disabled: true, onclick: () => show(true) });
  const buttons = SCHEMES.map(([name], i) => make("button", { type: "button", textContent: `${i + 1} ${name.split(",")[0]}`, onclick: () => run(i) }));

  async function run(scheme) {
    const [name, changes] = SCHEMES[scheme];
    found[scheme] = [];
    for (const stiffness of WALLS) {
      report.textContent = `${name}: hit on a wall of ${stiffness} N·m/rad …`;
      await new Promise((resolve) => setTimeout(resolve)); // the page stays alive between two hits
      const { kind, reasons, one } = rig.hit(RIG, { ...changes, "wall.stiffness": stiffness, "wall.damping": DAMPING, "trial.effort": EFFORT });
      found[scheme].push({ stiffness, kind, reasons, one });
      show(false);
    }
    report.textContent = `${name}: ${WALLS.length} hits.`;
    conclude.disabled = found.some((hits) => hits === null);
  }

  function show(concluding) {
    const cell = (hit) => make("td", {}, hit ? make("span", { className: "verdict", dataset: { kind: hit.kind }, title: hit.reasons.join("; "), textContent: hit.kind }) : "–");
    place.replaceChildren(make("table", { className: "ladder" },
      make("caption", { textContent: `${RIG}, B = ${DAMPING} N·m·s/rad, pushed with ${EFFORT} N·m` }),
      make("thead", {}, make("tr", {}, ...["K (N·m/rad)", ...SCHEMES.map(([name]) => name)].map((textContent) => make("th", { scope: "col", textContent })))),
      make("tbody", {}, ...WALLS.map((stiffness, i) => make("tr", {}, make("td", { textContent: stiffness }), ...found.map((hits) => cell(hits?.[i])))))));
    if (concluding) report.textContent = SCHEMES.map(([name], i) => `${name}: ${summary(found[i])}; linear theory: stable up to ${written(rig.limit(found[i][0].one).stable, 3)} N·m/rad`).join(". ") + ".";
  }

  return make("section", { className: "panel" }, make("h2", { textContent: "The experiment of the paper" }),
    make("p", { className: "quiet", textContent: "Does a slower velocity estimate allow a stiffer wall? Hit ever stiffer walls with both ways of sampling." }),
    make("p", { className: "steps" }, ...buttons, conclude), report, place);
}

// Up to which wall all hits were stable, and which walls were not.
function summary(hits) {
  const stable = hits.filter(({ kind }) => kind === "stable").length;
  const first = hits.find(({ kind }) => kind !== "stable");
  return first ? `${stable} of ${hits.length} walls stable, the first that is not has K = ${first.stiffness} (${first.kind})` : `all ${hits.length} walls stable`;
}
