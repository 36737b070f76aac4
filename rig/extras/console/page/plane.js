// The plane of stiffness over damping: one cell for each wall that was tried, linear theory over it, a cursor for mouse and keys.

import { cleared, colour, make, written } from "./dom.js";

const KINDS = ["stable", "limit-cycle", "unstable", "invalid"]; // as numbers of the server; also names of colours
const WORDS = ["stable", "limit cycle", "unstable", "invalid"];
const CRITERIA = { felt: "stable and not felt", heard: "stable and not heard", any: "stable and not felt, heard or moved" };
const FIDELITY = [[68, 1, 84], [59, 82, 139], [33, 145, 140], [94, 201, 98], [253, 231, 37]]; // viridis, as in the picture
const ROOMY = 6; // px: cells of this size stand a little apart
const PLACE = { left: 72, right: 14, top: 12, bottom: 44 };

export class Plane {
  // `open` is called with a cell: key of its column, and its stiffness.
  constructor(open) {
    this.open = open;
    this.columns = [];
    this.theory = [];
    this.scheme = 0;
    this.criterion = "any";
    this.canvas = make("canvas", { className: "plane", tabIndex: 0, role: "application", ariaLabel: "Plane of stiffness over damping: arrow keys choose a wall, Enter opens its hit",
      onpointermove: (event) => this.#hover(event), onpointerleave: () => { this.hovered = null; this.draw(); },
      onclick: (event) => this.#click(event), onkeydown: (event) => this.#key(event) });
    this.readout = make("p", { className: "quiet", role: "status", ariaLive: "polite" });
    this.legend = make("ul", { className: "legend" });
    this.criteria = make("select", { onchange: ({ target }) => { this.criterion = target.value; this.draw(); this.onchosen?.(); } });
    this.logarithmic = make("input", { type: "checkbox", onchange: () => this.draw() });
    this.judged = make("label", {}, "a wall passes if it is ", this.criteria);
    this.element = make("div", { className: "map" }, make("div", { className: "bar" }, this.judged, make("label", {}, this.logarithmic, " K logarithmic")),
      this.legend, make("div", { className: "charts" }, this.canvas), this.readout);
    new ResizeObserver(() => this.draw()).observe(this.canvas);
    matchMedia("(prefers-color-scheme: dark)").addEventListener("change", () => this.draw());
  }

  // Another map.
  show(map) {
    this.map = map;
    this.frequency = map.domain === "frequency";
    this.chosen = this.hovered = null;
    this.judged.hidden = this.frequency;
    this.criteria.replaceChildren(...map.criteria.map((name) => make("option", { value: name, textContent: CRITERIA[name] })));
    this.criteria.value = this.criterion;
    this.borders = borders(map.dampings);
    this.rungs = map.stiffnesses && borders(map.stiffnesses);
    this.draw();
  }

  choose(scheme) {
    this.scheme = scheme;
    this.chosen = this.hovered = null;
    this.#read(null);
    this.draw();
  }

  // The stiffest wall of a column up to which all pass; 0 where the softest fails.
  limit(column) {
    let found = 0;
    for (const cell of [...column.cells].sort((a, b) => a[0] - b[0])) {
      const passes = this.#passes(cell);
      if (passes === false) break;
      if (passes) found = cell[0];
    }
    return found;
  }

  // True, false, or null where a trial is invalid.
  #passes(cell) {
    if (this.frequency) return cell[1];
    const code = cell[2 + this.map.criteria.indexOf(this.criterion)];
    return code === 3 ? null : code === 0;
  }

  #shown() {
    return this.columns.filter((column) => column.scheme === this.scheme);
  }

  // Drawing.

  draw() {
    if (!this.map || this.canvas.offsetParent === null) return;
    const { context, width, height } = cleared(this.canvas);
    this.#scales(width, height);
    const columns = this.#shown();
    this.fills = KINDS.map(colour);
    this.failed = colour("line");
    if (this.frequency) this.range = fidelityRange(this.columns);
    context.globalAlpha = this.frequency ? 1 : 0.8;
    for (const column of columns) for (const cell of column.cells) this.#cell(context, column, cell);
    context.globalAlpha = 1;
    this.#theory(context);
    this.#axes(context, width, height);
    for (const [mark, stroke] of [[this.hovered, "quiet"], [this.chosen, "ink"]]) {
      if (!mark) continue;
      const { left, right, top, bottom } = this.#box(mark.column, mark.cell);
      context.strokeStyle = colour(stroke);
      context.lineWidth = 2;
      context.strokeRect(left - 1, top - 1, right - left + 2, bottom - top + 2);
    }
    this.#key_();
  }

  #scales(width, height) {
    const tried = this.columns.flatMap((column) => column.cells.map((cell) => cell[0]));
    const curves = this.theory.flatMap((curve) => curve.stiffness);
    const grid = this.map.stiffnesses ?? [];
    const measured = Math.max(...tried, ...grid, 0);
    const top = (Math.max(measured, Math.min(Math.max(...curves, 0), 2.5 * (measured || Infinity))) || 1) * 1.04; // theory may lie far above
    const lowest = Math.min(...tried, ...grid, top / 10) / (this.map.ratio ?? 1);
    const [first, last] = [this.borders[0], this.borders.at(-1)];
    const high = height - PLACE.bottom;
    this.x = (value) => PLACE.left + (value - first) / (last - first) * (width - PLACE.left - PLACE.right);
    this.damping = (x) => first + (x - PLACE.left) / (width - PLACE.left - PLACE.right) * (last - first);
    const share = this.logarithmic.checked ? (value) => Math.log(Math.max(value, lowest) / lowest) / Math.log(top / lowest) : (value) => value / top;
    this.y = (value) => high - share(value) * (high - PLACE.top);
    this.ticks = this.logarithmic.checked ? decades(lowest, top) : even(0, top, 6);
  }

  // A column of cells is as wide as its damping's share of the axis, and split among the series of that damping.
  #box(column, [stiffness]) {
    const stripes = this.map.stripes.length;
    const [from, to] = [this.x(this.borders[column.damping]), this.x(this.borders[column.damping + 1])];
    const each = (to - from) / stripes;
    const [low, high] = this.#reach(stiffness);
    return { left: from + column.stripe * each, right: from + (column.stripe + 1) * each, top: this.y(high), bottom: this.y(low) };
  }

  #reach(stiffness) {
    if (!this.frequency) return [stiffness / Math.sqrt(this.map.ratio), stiffness * Math.sqrt(this.map.ratio)];
    const place = this.map.stiffnesses.indexOf(stiffness);
    return [Math.max(0, this.rungs[place]), this.rungs[place + 1]];
  }

  #cell(context, column, cell) {
    const { left, right, top, bottom } = this.#box(column, cell);
    context.fillStyle = this.#fill(cell);
    const apart = bottom - top > ROOMY && right - left > ROOMY ? 1 : 0;
    context.fillRect(left, top, right - left - apart, Math.max(1, bottom - top - apart));
  }

  #fill(cell) {
    if (!this.frequency) return this.fills[cell[2 + this.map.criteria.indexOf(this.criterion)]];
    if (!cell[1]) return cell[2] === null ? this.fills[2] : this.failed;
    return fidelityColour(cell[2], this.range);
  }

  #theory(context) {
    this.theory.filter((curve) => curve.scheme === this.scheme).forEach(({ damping, stiffness }, number) => {
      for (const [stroke, lineWidth] of [[colour("paper"), 4], [colour("ink"), 1.5]]) {
        context.strokeStyle = stroke;
        context.lineWidth = lineWidth;
        context.setLineDash(lineWidth > 2 ? [] : number ? [2, 3] : [7, 4]);
        context.beginPath();
        damping.forEach((one, i) => context[i ? "lineTo" : "moveTo"](this.x(one), Math.max(PLACE.top, this.y(stiffness[i]))));
        context.stroke();
      }
    });
    context.setLineDash([]);
  }

  #axes(context, width, height) {
    const base = height - PLACE.bottom;
    context.strokeStyle = colour("line");
    context.lineWidth = 1;
    context.strokeRect(PLACE.left, PLACE.top, width - PLACE.left - PLACE.right, base - PLACE.top);
    context.fillStyle = colour("quiet");
    context.font = "12px system-ui";
    context.textAlign = "right";
    context.textBaseline = "middle";
    for (const tick of this.ticks) {
      context.fillText(written(tick, 3), PLACE.left - 6, this.y(tick));
      context.fillRect(PLACE.left - 4, this.y(tick), 4, 1);
    }
    context.textAlign = "center";
    context.textBaseline = "top";
    for (const tick of even(Math.max(0, this.borders[0]), this.borders.at(-1), 8)) {
      context.fillText(written(tick, 3), this.x(tick), base + 6);
      context.fillRect(this.x(tick), base, 1, 4);
    }
    context.fillText(`damping B (${this.map.units.damping})`, (PLACE.left + width) / 2, height - 18);
    context.save();
    context.translate(12, (PLACE.top + base) / 2);
    context.rotate(-Math.PI / 2);
    context.fillText(`stiffness K (${this.map.units.stiffness})`, 0, -6);
    context.restore();
  }

  #key_() {
    const curves = this.theory.filter((curve) => curve.scheme === this.scheme).map(({ name }, number) => [`${name} (${number ? "dotted" : "dashed"})`, colour("ink")]);
    const cells = this.frequency
      ? [[`passive, |Z| true to ${written(this.range[0], 2)} ${this.map.units.damping}`, fidelityColour(this.range[0], this.range)], [`passive, to ${written(this.range[1], 2)}`, fidelityColour(this.range[1], this.range)],
        ["not passive", colour("line")], ["handle thrown out", colour("unstable")]]
      : WORDS.map((word, number) => [word, colour(KINDS[number])]);
    const text = JSON.stringify([cells, curves]);
    if (text === this.drawnKey) return;
    this.drawnKey = text;
    this.legend.replaceChildren(...[...cells, ...curves].map(([name, fill]) => {
      const patch = make("i");
      patch.style.background = fill;
      if (!curves.some(([one]) => one === name)) patch.style.height = ".7rem";
      return make("li", {}, patch, name);
    }));
  }

  // Pointer and keys.

  #at(event) {
    const { left, top } = this.canvas.getBoundingClientRect();
    const [x, y] = [event.clientX - left, event.clientY - top];
    for (const column of this.#shown()) {
      for (const cell of column.cells) {
        const box = this.#box(column, cell);
        if (x >= box.left && x < box.right && y >= box.top && y < box.bottom) return { column, cell };
      }
    }
    return null;
  }

  #hover(event) {
    const found = this.#at(event);
    if (found?.cell === this.hovered?.cell) return;
    this.hovered = found;
    this.canvas.style.cursor = found && !this.frequency ? "pointer" : "default";
    this.#read(found ?? this.chosen);
    this.draw();
  }

  #click(event) {
    const found = this.#at(event);
    if (!found) return;
    this.chosen = found;
    this.#read(found);
    this.draw();
    if (!this.frequency) this.open({ key: found.column.key, stiffness: found.cell[0] });
  }

  // Left and right go from series to series, up and down along one; what is nearest there is chosen.
  #key(event) {
    const columns = this.#shown().sort((a, b) => a.damping - b.damping || a.stripe - b.stripe);
    if (!columns.length) return;
    if (event.key === "Enter" && this.chosen && !this.frequency) {
      this.open({ key: this.chosen.column.key, stiffness: this.chosen.cell[0] });
      return;
    }
    const step = { ArrowLeft: [-1, 0], ArrowRight: [1, 0], ArrowUp: [0, 1], ArrowDown: [0, -1] }[event.key];
    if (!step) return;
    event.preventDefault();
    const from = this.chosen ?? { column: columns[0], cell: columns[0].cells[0] };
    const place = Math.max(0, columns.findIndex((column) => column.key === from.column.key));
    const column = columns[Math.min(columns.length - 1, Math.max(0, place + step[0]))];
    const cells = [...column.cells].sort((a, b) => a[0] - b[0]);
    const near = cells.reduce((best, cell, i) => Math.abs(cell[0] - from.cell[0]) < Math.abs(cells[best][0] - from.cell[0]) ? i : best, 0);
    this.chosen = { column, cell: cells[Math.min(cells.length - 1, Math.max(0, near + (this.chosen ? step[1] : 0)))] };
    this.#read(this.chosen);
    this.draw();
  }

  #read(mark) {
    if (!mark) {
      this.readout.textContent = "";
      return;
    }
    const { column, cell } = mark;
    const { units, dampings, stripes } = this.map;
    const wall = `K ${written(cell[0], 4)} ${units.stiffness}, B ${written(dampings[column.damping], 3)} ${units.damping}`;
    const verdict = this.frequency ? `${cell[1] ? "passive" : "not passive"}${cell[2] === null ? "" : `, true to ${written(cell[2], 3)} ${units.damping}`}${cell[3] ? `: ${cell[3]}` : ""}`
      : `${WORDS[cell[1]]}; passes: ${this.map.criteria.filter((_, i) => cell[2 + i] === 0).join(", ") || "none"}`;
    this.readout.textContent = [wall, stripes[column.stripe], verdict].filter(Boolean).join(" · ");
  }
}

// Half-way between values; the outer borders as far as their neighbours'.
function borders(values) {
  if (values.length === 1) return [values[0] - (values[0] || 1) / 2, values[0] + (values[0] || 1) / 2];
  const between = values.slice(1).map((value, i) => (value + values[i]) / 2);
  return [2 * values[0] - between[0], ...between, 2 * values.at(-1) - between.at(-1)];
}

function even(low, high, most) {
  const raw = (high - low) / most || 1;
  const power = 10 ** Math.floor(Math.log10(raw));
  const step = [1, 2, 5, 10].map((one) => one * power).find((one) => one >= raw);
  const ticks = [];
  for (let tick = Math.ceil(low / step) * step; tick <= high; tick += step) ticks.push(Number(tick.toPrecision(12)));
  return ticks;
}

function decades(low, high) {
  const ticks = [];
  for (let power = Math.floor(Math.log10(low)); power <= Math.log10(high); power++) for (const one of [1, 2, 5]) ticks.push(one * 10 ** power);
  return ticks.filter((tick) => tick >= low && tick <= high);
}

// From the smallest error to the largest; the largest few per cent share one colour.
function fidelityRange(columns) {
  const values = columns.flatMap((column) => column.cells.filter((cell) => cell[1] && cell[2] !== null).map((cell) => cell[2])).sort((a, b) => a - b);
  if (!values.length) return [0, 1];
  const high = values[Math.floor(0.98 * (values.length - 1))];
  return [values[0], high > values[0] ? high : values[0] + 1];
}

function fidelityColour(value, [low, high]) {
  const place = Math.min(1, Math.max(0, (value - low) / (high - low))) * (FIDELITY.length - 1);
  const from = Math.min(FIDELITY.length - 2, Math.floor(place));
  const mixed = FIDELITY[from].map((one, i) => Math.round(one + (place - from) * (FIDELITY[from + 1][i] - one)));
  return `rgb(${mixed.join(" ")})`;
}
