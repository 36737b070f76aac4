// The data of the scope: the points of one window, in arrays of fixed size.

const CAPACITY = 4096; // a window has some 1000 points, each drawn as least and greatest

export class Traces {
  constructor() {
    this.columns = [];
    this.clear();
  }

  clear() {
    this.length = 0;
    this.times = new Float64Array(CAPACITY);
    this.values = {};
  }

  // Append a frame; a `fresh` one replaces all points.
  add(frame) {
    if (frame.fresh || frame.columns.join() !== this.columns.join()) {
      this.columns = frame.columns;
      this.clear();
      for (const name of this.columns) this.values[name] = new Float64Array(CAPACITY);
    }
    const each = this.each = frame.step === 1 ? 1 : 2; // values of a point
    const skipped = Math.max(0, frame.points - Math.floor(CAPACITY / each));
    const added = (frame.points - skipped) * each;
    const over = this.length + added - CAPACITY;
    if (over > 0) this.#drop(over);
    for (let i = skipped; i < frame.points; i++) {
      for (let j = 0; j < each; j++) {
        this.times[this.length] = frame.times[i];
        for (const name of this.columns) {
          this.values[name][this.length] = (j === 0 ? frame.low : frame.high)[name][i];
        }
        this.length++;
      }
    }
  }

  // Remove points older than a time (s).
  forget(before) {
    let count = 0;
    while (count < this.length && this.times[count] < before) count++;
    if (count > 0) this.#drop(count);
  }

  get newest() {
    return this.length ? this.times[this.length - 1] : 0;
  }

  get oldest() {
    return this.length ? this.times[0] : 0;
  }

  // Times, or a column, as far as they are filled; not a number becomes a gap.
  series(name) {
    const from = name === undefined ? this.times : this.values[name];
    return from ? from.subarray(0, this.length) : new Float64Array(0);
  }

  #drop(count) {
    for (const array of [this.times, ...Object.values(this.values)]) array.copyWithin(0, count, this.length);
    this.length -= count;
  }
}
