// Cursors and zoom of a group of charts by keys, for users without a pointer. `range` returns the time that is shown,
// `cursor` that of the newest cursor; `move` is called with its new time, `place` with that of another cursor, `zoom`
// with a range of time.

const STEPS = 100; // of what is shown
const FAST = 10; // steps, with Shift

export function byKeys(charts, { range, cursor, move, place, zoom }) {
  charts.tabIndex = 0;
  charts.role = "application";
  charts.ariaLabel = "Charts over time: left and right move a cursor, with Shift faster, Enter sets another one, plus and minus zoom";
  charts.addEventListener("keydown", (event) => {
    if (event.ctrlKey || event.altKey || event.metaKey) return;
    const [first, last] = range();
    const span = last - first;
    const at = Math.min(last, Math.max(first, cursor() ?? (first + last) / 2));
    const step = { ArrowLeft: -1, ArrowRight: 1 }[event.key];
    const share = { "+": 0.5, "-": 2 }[event.key];
    if (step) move(Math.min(last, Math.max(first, at + step * (event.shiftKey ? FAST : 1) * span / STEPS)));
    else if (share) zoom(at - share * (at - first), at + share * (last - at));
    else if (event.key === "Enter") place(at);
    else return;
    event.preventDefault();
  });
}
