// What the scope shows, as a file: a picture of its charts, one that is drawn anew, or its numbers.

import { colour, make } from "./dom.js";
import { SAVED } from "./effort_plane.js";

const WIDTH = 1000;
const HEIGHT = 220; // of a panel

export function offer(blob, name) {
  const url = URL.createObjectURL(blob);
  make("a", { href: url, download: name }).click();
  setTimeout(() => URL.revokeObjectURL(url), 1000);
}

// The result of a cut.
export function savedAs({ name, rows, no_replay }) {
  return `Saved ${rows} rows as ${name}.${no_replay ? ` It has no replay: ${no_replay}.` : ""}`;
}

// A choice of forms, which falls back to none when one was chosen.
export function saving(forms, save) {
  const select = make("select", { ariaLabel: "save", onchange: () => {
    const form = select.value;
    select.value = "";
    save(form);
  } }, ...[["…", ""], ...forms].map(([textContent, value]) => make("option", { textContent, value })));
  return make("label", {}, "save ", select);
}

export const FORMS = [["PNG", "png"], ["SVG", "svg"], ["CSV", "csv"], ["cut recording", "cut"]];

// What is seen: traces with the units of their columns, the canvases that show them, and what an SVG draws anew: charts
// over a range of time, or a plane (null: one that has nothing to show).
export function saveSeen(form, { traces, unit, canvases, charts, range, plane }, name) {
  if (form === "csv") saveCsv(traces, unit, name);
  else if (form === "png") savePng(canvases, name);
  else if (plane === undefined) saveSvg(charts, traces, unit, range, name);
  else if (plane !== null) savePlaneSvg(plane, name);
}

function savePng(canvases, name) {
  const whole = make("canvas", { width: Math.max(...canvases.map((one) => one.width)), height: canvases.reduce((sum, one) => sum + one.height, 0) });
  const context = whole.getContext("2d");
  context.fillStyle = colour("paper");
  context.fillRect(0, 0, whole.width, whole.height);
  let top = 0;
  for (const canvas of canvases) {
    context.drawImage(canvas, 0, top);
    top += canvas.height;
  }
  whole.toBlob((blob) => offer(blob, `${name}.png`));
}

function saveCsv(traces, unit, name) {
  const columns = traces.columns;
  const head = ["time (s)", ...columns.map((column) => `${column} (${unit(column)})`)].join(",");
  const rows = [...traces.series()].map((time, i) => [time, ...columns.map((column) => traces.series(column)[i])].join(","));
  offer(new Blob([[head, ...rows].join("\n"), "\n"], { type: "text/csv" }), `${name}.csv`);
}

function saveSvg(charts, traces, unit, [first, last], name) {
  const times = traces.series();
  const place = { left: 90, right: WIDTH - 15, top: 12, bottom: HEIGHT - 30 };
  const panels = charts.map(({ title, series }, number) => {
    const values = series.map(([column]) => traces.series(column));
    const all = values.flatMap((one) => [...one]).filter(Number.isFinite);
    const [low, high] = all.length ? [Math.min(...all), Math.max(...all)] : [0, 1];
    const span = high - low || 1;
    const x = (time) => (place.left + (time - first) / (last - first || 1) * (place.right - place.left)).toFixed(2);
    const y = (value) => (place.bottom - (value - low) / span * (place.bottom - place.top)).toFixed(2);
    const paths = series.map(([, key], i) => {
      const points = [...times].map((time, k) => `${x(time)},${y(values[i][k])}`).join(" ");
      return `<polyline fill="none" stroke="${colour(key)}" points="${points}"/>`;
    });
    const text = (left, top, words) => `<text x="${left}" y="${top}" font-family="sans-serif" font-size="12" fill="#333333">${words}</text>`;
    return `<g transform="translate(0 ${number * HEIGHT})"><rect x="${place.left}" y="${place.top}" width="${place.right - place.left}" `
      + `height="${place.bottom - place.top}" fill="none" stroke="#cccccc"/>${paths.join("")}`
      + text(4, place.top + 12, `${title} (${unit(series[0][0])})`) + text(4, place.top + 30, high.toPrecision(4)) + text(4, place.bottom, low.toPrecision(4))
      + text(place.left, HEIGHT - 10, `${first.toFixed(4)} s`) + text(place.right - 70, HEIGHT - 10, `${last.toFixed(4)} s`) + "</g>";
  });
  const svg = `<svg xmlns="http://www.w3.org/2000/svg" width="${WIDTH}" height="${HEIGHT * charts.length}">`
    + `<rect width="100%" height="100%" fill="#ffffff"/>${panels.join("")}</svg>`;
  offer(new Blob([svg], { type: "image/svg+xml" }), `${name}.svg`);
}

function savePlaneSvg(plane, name) {
  const { width, height } = SAVED;
  const paths = plane.lines.map(([points, key]) => `<polyline fill="none" stroke="${colour(key)}" points="${points.map(([x, y]) => `${x.toFixed(2)},${y.toFixed(2)}`).join(" ")}"/>`);
  const texts = plane.texts.map(([x, y, text, key]) => `<text x="${x.toFixed(2)}" y="${y.toFixed(2)}" font-family="sans-serif" font-size="12" fill="${colour(key)}">${text}</text>`);
  const svg = `<svg xmlns="http://www.w3.org/2000/svg" width="${width}" height="${height}"><rect width="100%" height="100%" fill="${colour("paper")}"/>${paths.join("")}${texts.join("")}</svg>`;
  offer(new Blob([svg], { type: "image/svg+xml" }), `${name}.svg`);
}
