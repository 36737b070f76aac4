// The participant's screen: the cue, the instruction and the question. It can answer and stop, nothing else.

import { Answering, nameOf } from "./desk.js";
import { make, setText } from "./dom.js";
import { Link } from "./link.js";

const WAIT = "Please wait";
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

link.addEventListener("participant", ({ detail: report }) => {
  const text = report.cue ?? WAIT; // no session has begun
  setText(cue, report.left_s > 0 ? `${text}: ${report.left_s} s` : text);
  setText(saying, report.saying ?? "");
  cue.dataset.moving = Boolean(report.moves);
  answering.show({ asked: report.asked ?? 0, text: "", offered: report.runs ? report.verdicts ?? [] : [], entry: report.runs && report.item ? "item" : null, item: report.item, notice: report.notice ?? "", moving: false });
});
// The reason names tokens and the console: that is for the operator's page.
link.addEventListener("closed", () => { setText(cue, WAIT); setText(saying, "This screen lost its connection. Please call the operator."); });
