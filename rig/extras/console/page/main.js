// The page: a header that is always there, with STOP; and views, of which one is shown.

import { devicesView } from "./devices.js";
import { make } from "./dom.js";
import { Handle } from "./handle.js";
import { Link } from "./link.js";
import { Maps } from "./maps.js";
import { Recordings } from "./recordings.js";
import { Scope } from "./scope.js";
import { Sessions } from "./sessions.js";
import { Sound } from "./sound.js";
import { notice, offerStop } from "./stop.js";
import { Wall } from "./wall.js";

const link = new Link();
const $ = (id) => document.getElementById(id);
const views = {};

offerStop(() => link.stop());

$("operate").addEventListener("click", () => link.ask("operate", { take: true }).catch(notice));

link.addEventListener("trouble", ({ detail }) => notice(detail));
link.addEventListener("closed", ({ detail }) => {
  $("consent").hidden = true;
  $("state").textContent = detail ? `not connected: ${detail}` : "not connected: is the console still running?";
});
// The same text as at the terminal.
link.addEventListener("consent", ({ detail: { lines } }) => {
  $("consent").hidden = lines === null;
  $("consent").querySelector("ul").replaceChildren(...(lines ?? []).map((textContent) => make("li", { textContent })));
});
link.addEventListener("stopped", () => say("STOP was sent"));

function say(text) {
  if ($("state").textContent !== text) $("state").textContent = text;
}

link.addEventListener("state", ({ detail }) => {
  const { loop, operates, operated, job, blinded } = detail;
  $("operate").hidden = operates;
  $("operate").disabled = operated;
  $("operate").textContent = operated ? "Another page operates the rig" : "Operate";
  if (loop === null) say(blinded ? "blinded session: its loops are hidden" : job ? `${job}: starting` : "no loop is running");
  else if (loop.ended !== null) say(`ended: ${loop.ended}`);
  else {
    const lost = loop.counters.lost + loop.counters.skipped;
    say(`${loop.phase}${loop.inside ? ", inside the wall" : ""}, set ${loop.set}${lost ? `, ${lost} samples lost` : ""}${loop.fault && loop.fault !== "none" ? `, fault ${loop.fault}` : ""}`);
  }
});

// Views: each a name, a title and what makes its element, once, when it is first shown.
export function addView(name, title, build) {
  const button = make("button", { type: "button", textContent: title, onclick: () => show(name) });
  $("tabs").append(button);
  views[name] = { button, build, element: null };
}

function show(name) {
  for (const [other, view] of Object.entries(views)) {
    const shown = other === name;
    if (shown && view.element === null) {
      view.element = view.build();
      view.element.classList.add("view");
      $("views").append(view.element);
    }
    if (view.element) view.element.hidden = !shown;
    if (shown) view.button.setAttribute("aria-current", "page");
    else view.button.removeAttribute("aria-current");
  }
}

link.addEventListener("hello", ({ detail: facts }) => {
  if (views.live) return; // connected again
  addView("live", "Live", () => {
    const scope = new Scope(link, facts);
    const side = make("div", { className: "side" }, new Handle(link).element, new Wall(link, facts).element, new Sound(link).element);
    globalThis.rigConsole = { scope };
    return make("div", {}, scope.element, side);
  });
  const sessions = new Sessions(link, facts); // at once: a page that reconnects receives the state of a session immediately
  addView("sessions", "Sessions", () => sessions.element);
  const recordings = new Recordings(link);
  const open = (which) => {
    show("recordings");
    recordings.open(which);
  };
  addView("maps", "Maps", () => new Maps(link, facts, open).element);
  addView("recordings", "Recordings", () => recordings.begin());
  addView("devices", "Devices", () => devicesView(link, facts));
  show("live");
  link.addEventListener("session", ({ detail }) => { if (detail.runs) show("sessions"); }, { once: true });
});
