// Effort over penetration with the ideal wall: what it consists of, and how it is drawn. The slope is the stiffness that
// the hand meets, the area between the branches the energy that the wall gives or takes.

import { cleared, colour, written } from "./dom.js";

export const SAVED = { width: 1000, height: 700 };

// Frame, lines and texts in pixels; null where there is nothing to show. `unit` gives the unit of a column.
export function planeOf(traces, wall, unit, { width, height }) {
  const x = traces.series("penetration");
  const y = traces.series("effort_applied");
  if (!x.length || !y.length || !wall) return null;
  const { side, stiffness } = wall;
  const most = (values, sign) => values.reduce((found, value) => Math.max(found, sign * value), 0);
  const deep = Math.max(most(x, 1), 1e-6);
  const right = deep * 1.1;
  const left = -0.25 * right;
  const high = Math.max(most(y, -side), stiffness * deep, 1e-9);
  const top = high * 1.1;
  const bottom = -0.15 * top;
  const place = { left: 70, right: width - 12, top: 12, bottom: height - 40 };
  const at = (penetration, effort) => [place.left + (penetration - left) / (right - left) * (place.right - place.left),
    place.bottom - (effort - bottom) / (top - bottom) * (place.bottom - place.top)];
  const spring = (penetration) => at(penetration, stiffness * penetration);
  const [springX, springY] = spring(right * 0.6);
  return {
    place,
    lines: [
      [[at(0, bottom), at(0, top)], "wall"],
      [[at(left, 0), at(right, 0)], "line"],
      [[at(0, 0), spring(right)], "true"],
      [pairs(x, y, side, traces.each).map(([penetration, effort]) => at(penetration, -side * effort)), "measured"],
    ],
    texts: [
      [place.left, height - 12, `penetration (${unit("penetration")}), up to ${written(deep, 3)}`, "quiet"],
      [place.left + 4, place.top + 10, `active effort against it (${unit("effort_applied")}), up to ${written(high, 3)}`, "quiet"],
      [springX + 8, springY + 14, "ideal spring", "ink"],
    ],
  };
}

// Least and greatest values of one bucket come one after the other, each column's own: the deepest penetration belongs
// to the strongest effort against it, which is the least one of a wall on the positive side.
export function pairs(x, y, side, each) {
  const other = each === 2 && side > 0 ? 1 : 0;
  return Array.from(x, (penetration, i) => [penetration, y[i ^ other]]);
}

export function drawPlane(canvas, traces, wall, unit) {
  const { context, width, height } = cleared(canvas);
  const plane = planeOf(traces, wall, unit, { width, height });
  if (plane === null) return;
  const { place, lines, texts } = plane;
  context.save();
  context.beginPath();
  context.rect(place.left, place.top, place.right - place.left, place.bottom - place.top);
  context.clip();
  for (const [points, key] of lines) {
    context.strokeStyle = colour(key);
    context.beginPath();
    points.forEach(([x, y], i) => context[i ? "lineTo" : "moveTo"](x, y));
    context.stroke();
  }
  context.restore();
  context.font = "12px system-ui";
  for (const [x, y, text, key] of texts) {
    context.fillStyle = colour(key);
    context.fillText(text, x, y);
  }
}
