// The rows of a run that a scope draws: the newest in a ring, cut to points of least and greatest values.

const ROWS = 1 << 17; // 6.5 s at 20 kHz
const POINTS = 1000; // of a window

export class Rows {
  constructor(names, rate) {
    this.names = names;
    this.rate = rate;
    this.count = 0;
    this.values = Object.fromEntries(names.map((name) => [name, new Float64Array(ROWS)]));
  }

  get oldest() {
    return Math.max(0, this.count - ROWS);
  }

  add(row) {
    for (const name of this.names) this.values[name][this.count % ROWS] = row[name];
    this.count++;
  }

  at(name, row) {
    return this.values[name][row % ROWS];
  }

  // Points over `step` rows each from row `first` to `last`, as a frame of the console's server.
  cut(columns, first, last, step, header) {
    first = Math.max(first, this.oldest);
    const points = Math.max(0, Math.floor((Math.min(last, this.count) - first) / step));
    const times = Float64Array.from({ length: points }, (_, i) => (first + i * step) / this.rate);
    const low = {}, high = {};
    for (const name of columns) {
      low[name] = new Float64Array(points);
      high[name] = step === 1 ? low[name] : new Float64Array(points);
      for (let i = 0; i < points; i++) {
        let least = Infinity, most = -Infinity;
        for (let row = first + i * step; row < first + (i + 1) * step; row++) {
          const value = this.at(name, row);
          if (value < least) least = value;
          if (value > most) most = value;
        }
        low[name][i] = least;
        high[name][i] = most;
      }
    }
    return { ...header, first, step, columns, points, times, low, high };
  }
}

// What one scope has not received yet: rig.extras.console.view.
export class View {
  constructor(rows, { columns, window_s, trigger }) {
    Object.assign(this, { rows, columns: columns.filter((name) => rows.names.includes(name)), trigger });
    this.window = Math.max(2, Math.round(window_s * rows.rate));
    this.step = Math.max(1, Math.floor(this.window / POINTS));
    this.next = Math.floor(Math.max(rows.oldest, rows.count - this.window) / this.step) * this.step;
    this.searched = Math.max(1, rows.count);
    this.fresh = true;
  }

  frame() {
    return this.trigger ? this.#sweep() : this.#live();
  }

  #live() {
    const last = Math.floor(this.rows.count / this.step) * this.step;
    if (last <= this.next && !this.fresh) return null;
    const frame = this.rows.cut(this.columns, this.next, last, this.step, { kind: "live", fresh: this.fresh, newest: Date.now() });
    [this.next, this.fresh] = [last, false];
    return frame;
  }

  #sweep() {
    const { on, edge, level, before, single } = this.trigger;
    const above = (row) => (on === "contact" ? this.rows.at("penetration", row) > 0 : this.rows.at(on, row) > level);
    for (; this.hit === undefined && !this.done && this.searched < this.rows.count; this.searched++) {
      if (above(this.searched) === (edge === "rising") && above(this.searched - 1) !== (edge === "rising")) this.hit = this.searched;
    }
    const first = this.hit - Math.round(before * this.window);
    if (this.hit === undefined || this.rows.count < first + this.window) return null;
    const frame = this.rows.cut(this.columns, first, first + this.window, this.step, { kind: "sweep", fresh: true, at: this.hit / this.rows.rate });
    this.done = single;
    this.searched = Math.max(this.searched, first + this.window);
    this.hit = undefined;
    return frame;
  }
}
