// Devices: the connected ones, the doctor's report on this machine and a link, and the meaning of each fault.

import { make, showStage } from "./dom.js";
import { shown } from "./items.js";

export function devicesView(link, facts) {
  const here = make("div", {}, "looking …");
  const found = make("div", { role: "status", ariaLive: "polite" });
  const faults = make("tbody");
  const url = make("input", { type: "text", value: "sim://", ariaLabel: "URL of the device to examine; leave empty for this computer only" });
  const rig = make("select", { ariaLabel: "Rig" }, ...facts.rigs.map((name) => make("option", { value: name, textContent: name })));
  rig.value = facts.rigs.includes("koul-compliant") ? "koul-compliant" : facts.rigs[0];
  const trouble = (error) => link.dispatchEvent(new CustomEvent("trouble", { detail: error }));

  async function look() {
    try {
      const report = await link.ask("devices");
      here.replaceChildren(...shown(report.items));
      faults.replaceChildren(...report.faults.map(({ name, text, remedy }) => make("tr", {},
        make("th", { scope: "row", textContent: name.toLowerCase().replaceAll("_", " ") }), make("td", { textContent: text }), make("td", { textContent: remedy }))));
    } catch (error) {
      trouble(error);
    }
  }

  link.addEventListener("progress", ({ detail }) => {
    if (detail.job === "doctor") showStage(found, detail.told.stage, detail.told.share);
  });
  link.addEventListener("job", ({ detail: { job, told: report } }) => {
    if (job !== "doctor") return;
    if (report.say === "done") found.replaceChildren(...shown(report.result.items), report.result.error ?? "");
    if (report.say === "failed") found.replaceChildren([report.error, report.remedy].filter(Boolean).join(": "));
  });
  look();
  return make("div", { className: "columns" },
    make("section", { className: "panel" }, make("h2", { textContent: "Connected" }), make("button", { type: "button", textContent: "Look again", onclick: look }), here),
    make("section", { className: "panel wide" }, make("h2", { textContent: "What a link can do" }),
      make("p", {}, url, " ", rig, " ", make("button", { type: "button", textContent: "Examine",
        onclick: () => link.ask("examine", { url: url.value, rig: rig.value }).then(() => found.replaceChildren("examining …"), trouble) })), found),
    make("section", { className: "panel wide" }, make("h2", { textContent: "Faults" }),
      make("table", {}, make("thead", {}, make("tr", {}, ...["fault", "meaning", "what to do"].map((text) => make("th", { textContent: text })))), faults)));
}
