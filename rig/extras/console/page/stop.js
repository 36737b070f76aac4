// STOP and the notice of an error: in the header of the console and of the page of a wall.

const NOTICE_MS = 12000;
const CONTROLS = "input, select, textarea, button, [role=slider], [contenteditable]";
const $ = (id) => document.getElementById(id);

// STOP by its button, by Escape everywhere, and by Space outside of text fields and controls.
export function offerStop(stop) {
  $("stop").addEventListener("pointerdown", stop);
  $("stop").addEventListener("click", stop);
  addEventListener("keydown", (event) => {
    const space = event.key === " " && !event.target.closest(CONTROLS);
    if (event.key !== "Escape" && !space) return;
    event.preventDefault();
    stop();
  }, { capture: true });
}

let silence = 0;

export function notice(error) {
  $("notice").textContent = error.message;
  $("notice").hidden = false;
  clearTimeout(silence);
  silence = setTimeout(() => { $("notice").hidden = true; }, NOTICE_MS);
}
