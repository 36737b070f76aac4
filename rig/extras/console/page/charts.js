// Charts over time that share one time axis, live or of a recording: their look, the wall, names of the series, marks.

import { colour, written } from "./dom.js";

export const NAMES = { effort_wanted: "wanted", effort_sent: "sent", effort_applied: "active", position: "measured", velocity: "estimated" };

// Options of one uPlot chart. `range` gives the time that is shown, `height` the values of the vertical axis for theirs, `marks` draws over it, `zoom` and `click` are called on actions of the pointer.
export function chartOptions({ title, unit, series, last, group, range, height, marks, zoom, click }) {
  const grid = { stroke: colour("grid"), width: 1 };
  const axis = { stroke: colour("quiet"), grid, ticks: grid, font: "12px system-ui" };
  return {
    width: 400, height: 160, legend: { show: false },
    cursor: { sync: { key: group }, drag: { x: true, y: false, setScale: false } },
    scales: { x: { time: false, auto: false, range }, ...(height ? { y: { range: (_, low, high) => height(low, high) } } : {}) },
    axes: [
      { ...axis, ...(last ? { label: "s since the first sample", labelSize: 18, size: 36 } : { size: 26 }) },
      { ...axis, size: 78, values: (_, ticks) => ticks.map((tick) => written(tick, 6)), label: `${title} (${unit})`, labelSize: 18 },
    ],
    series: [{}, ...series.map(([, key]) => ({ stroke: colour(key), width: 1.25, points: { show: false } }))],
    hooks: {
      draw: [marks],
      setSelect: [zoom],
      ready: [(plot) => {
        plot.over.addEventListener("click", () => click(plot));
        Object.assign(plot.root, { role: "img", ariaLabel: `${title} (${unit}) over time` });
      }],
    },
  };
}

// The time that was selected on a chart, or null where it was only a click; the selection is taken away.
export function selected(plot) {
  const { left, width } = plot.select;
  if (width < 4) return null;
  const times = [plot.posToVal(left, "x"), plot.posToVal(left + width, "x")];
  plot.setSelect({ left: 0, width: 0, top: 0, height: 0 }, false);
  return times;
}

// Draw over a chart, inside its axes.
export function inside(plot, draw) {
  const { ctx, bbox } = plot;
  ctx.save();
  ctx.beginPath();
  ctx.rect(bbox.left, bbox.top, bbox.width, bbox.height);
  ctx.clip();
  draw(ctx, bbox);
  ctx.restore();
}

export function shadeWall(plot, wall) {
  const { ctx, bbox } = plot;
  const y = plot.valToPos(wall.position, "y", true);
  const [top, height] = wall.side > 0 ? [bbox.top, y - bbox.top] : [y, bbox.top + bbox.height - y];
  ctx.globalAlpha = 0.15;
  ctx.fillStyle = colour("wall");
  ctx.fillRect(bbox.left, top, bbox.width, height);
  ctx.globalAlpha = 1;
  line(ctx, bbox.left, y, bbox.left + bbox.width, y, colour("wall"));
}

// Names of the series along the top of a chart, each behind a stroke of its colour, on paper so that curves leave them readable.
export function nameSeries(plot, named) {
  const { ctx, bbox } = plot;
  const ratio = devicePixelRatio;
  let left = bbox.left + 6 * ratio;
  ctx.font = `${12 * ratio}px system-ui`;
  ctx.textAlign = "left";
  ctx.textBaseline = "alphabetic";
  for (const [name, key] of named) {
    const width = ctx.measureText(name).width + 18 * ratio;
    ctx.globalAlpha = 0.8;
    ctx.fillStyle = colour("paper");
    ctx.fillRect(left - 3 * ratio, bbox.top, width + 6 * ratio, 17 * ratio);
    ctx.globalAlpha = 1;
    ctx.fillStyle = colour(key);
    ctx.fillRect(left, bbox.top + 7 * ratio, 14 * ratio, 3 * ratio);
    ctx.fillStyle = colour("ink");
    ctx.fillText(name, left + 18 * ratio, bbox.top + 13 * ratio);
    left += width + 12 * ratio;
  }
}

export function upright(plot, time, stroke) {
  const x = plot.valToPos(time, "x", true);
  line(plot.ctx, x, plot.bbox.top, x, plot.bbox.top + plot.bbox.height, stroke);
}

export function line(context, x0, y0, x1, y1, stroke) {
  context.strokeStyle = stroke;
  context.lineWidth = 1;
  context.beginPath();
  context.moveTo(x0, y0);
  context.lineTo(x1, y1);
  context.stroke();
}
