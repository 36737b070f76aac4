// The participant's screen: the cue, what to do, and what is asked of them. It answers that, stops, and does nothing else.

import { Answering, nameOf } from "./desk.js";
import { make, setText } from "./dom.js";
import { Link } from "./link.js";

const link = new Link("participant");
const answering = new Answering(link, { participant: true });
const cue = make("p", { className: "cue", role: "status", ariaLive: "assertive" });
const saying = make("p", { className: "saying", role: "status" });
document.getElementById("screen").append(cue, saying, answering.element);

document.getElementById("stop").addEventListener("pointerdown", () => link.stop());
document.getElementById("stop").addEventListener("click", () => link.stop());

addEventListener("keydown", (event) => {
  const typed = event.target.closest("input");
  if (event.key === "Escape" || (event.key === " " && !typed)) {
    event.preventDefault();
    link.stop();
  } else if (event.repeat && event.key === "Enter") {
    event.preventDefault(); // held on a button, it would press that again and again
  } else if (!typed && !event.repeat && !event.ctrlKey && !event.altKey && !event.metaKey && event.key !== "Enter" && event.key !== "Tab") {
    answering.press(nameOf(event.key));
  }
}, { capture: true });
addEventListener("keyup", (event) => { if (event.key === " " && !event.target.closest("input")) event.preventDefault(); });

link.addEventListener("participant", ({ detail: told }) => {
  const there = told.state !== undefined;
  setText(cue, !there ? "please wait" : told.left_s > 0 ? `${told.state}: ${told.left_s} s` : told.state);
  setText(saying, there ? told.saying : "");
  cue.dataset.moving = ["go", "hold"].includes(told.state);
  answering.show({ asked: told.asked ?? 0, text: "", offered: told.runs ? told.verdicts ?? [] : [], entry: told.runs && told.item ? "item" : null, item: told.item, notice: told.notice ?? "", moving: false });
});
link.addEventListener("closed", ({ detail }) => { setText(cue, "please wait"); setText(saying, detail ?? ""); });
