// The compiled rig: firmware and plant (rig.c), and the numbers of a verdict (measure.c).

export class Module {
  // `compiled`: a WebAssembly.Module, of which each instance has memory of its own; `layout`: the names in the enumerations
  // of rig.h, in its order.
  static async of(compiled, layout) {
    return new Module((await WebAssembly.instantiate(compiled, {})).exports, layout);
  }

  constructor(exports, [columns, , numbers, marks]) {
    this.c = exports;
    exports._initialize();
    const named = (names, value) => Object.fromEntries(names.map((name, place) => [name.replace("RIG_", "").toLowerCase(), value(place)]));
    this.at = named(columns, (place) => place);
    this.mark = named(marks, (place) => 1 << place);
    this.columns = columns.length - 1; // the last names count
    this.numbers = numbers.slice(0, -1).map((name) => name.toLowerCase());
    this.mostRows = exports.rig_most_rows();
  }

  #floats(global, length) {
    return new Float64Array(this.c.memory.buffer, global.value, length);
  }

  #send(block) {
    new Uint8Array(this.c.memory.buffer, this.c.rig_block.value, block.length).set(block);
    return block.length;
  }

  // Set up rig and device, arm, and start the law; returns 0, or status and parameter of the device's refusal.
  begin(setup, block) {
    this.#floats(this.c.rig_setup, setup.length).set(setup);
    return this.c.rig_begin(this.#send(block));
  }

  change(block) {
    return this.c.rig_change(this.#send(block));
  }

  get waits() {
    return this.c.rig_waits() !== 0;
  }

  get fault() {
    return this.c.rig_fault();
  }

  // Run some ticks; `script` has intended position, velocity and press for each. Returns the rows, one after the other,
  // in memory that the next run overwrites.
  run(ticks, script = new Float64Array(0)) {
    this.#floats(this.c.rig_script, script.length).set(script);
    const rows = this.c.rig_run(ticks, script.length / 3);
    return this.#floats(this.c.rig_rows, rows * this.columns);
  }

  // The numbers of a trial's verdict, by name. `signals`: position, effort, penetration and marks, an array each.
  measure(signals, meter) {
    this.#floats(this.c.rig_meter, meter.length).set(meter);
    const memory = this.#floats(this.c.rig_signals, signals.length * this.mostRows);
    signals.forEach((signal, i) => memory.set(signal, i * this.mostRows));
    this.c.rig_measure(signals[0].length);
    const values = this.#floats(this.c.rig_numbers, this.numbers.length);
    return Object.fromEntries(this.numbers.map((name, place) => [name, values[place]]));
  }
}
