'use strict';
/* The converter of ±10 V behind the pins, as the AD5761R's data sheets have it (AD5761R-EP, Rev. 0, Tables 1 and 4; AD5761R,
 * Rev. C, Table 15): SDI counts where SCLK falls while SYNC is low, a frame where SYNC rises. RESET is the enable wire: while
 * it is low nothing is accepted, and the output is clamped to ground until the control register has been written. */
const BITS = 24;
const WRITE_AND_UPDATE = 3;
const CONTROL = 4;
const RANGE_MASK = 7; // 0: ±10 V
const CLEAR_AND_POWER_UP = (3 << 9) | (3 << 3);
const BOTH_MIDDLE = (1 << 9) | (1 << 3);
const OWN_REFERENCE = 1 << 5;
const FULL_SCALE_V = 10;
const SHORTEST_CLOCK_NS = 20;
const TOLERANCE_NS = 1e-3;

class Converter {
  /* `told` hears of what the data sheet does not allow. */
  constructor(told) {
    this.told = told;
    this.sync = this.clock = false;
    this.bits = 0;
    this.word = 0;
    this.fell = -Infinity; // SCLK, ns
    this.frames = []; // { began, ended, word, accepted }: ns
    this.reset();
  }

  /* RESET is low. */
  reset() {
    this.ready = false;
    this.code = 0x8000;
  }

  get volts() {
    return this.ready ? ((this.code - 0x8000) / 0x8000) * FULL_SCALE_V : 0;
  }

  /* Levels of the three pins, at every change; `awake` is RESET's. */
  see(sync, clock, data, at, awake) {
    if (this.sync && !sync) {
      this.bits = this.word = 0;
      this.began = at;
    }
    if (!this.sync && !sync && this.clock && !clock) {
      if (at - this.fell < SHORTEST_CLOCK_NS - TOLERANCE_NS) this.told('SCLK is too fast');
      this.fell = at;
      this.word = ((this.word << 1) | (data ? 1 : 0)) >>> 0;
      this.bits++;
    }
    if (!this.sync && sync && this.bits > 0) {
      if (this.bits === BITS) this.take(at, awake);
      else this.told(`a frame has ${this.bits} bits`);
    }
    this.sync = sync;
    this.clock = clock;
  }

  take(at, awake) {
    const { word } = this;
    this.frames.push({ began: this.began, ended: at, word, accepted: awake });
    if (!awake) return;
    const command = word >>> 16;
    const data = word & 0xffff;
    if (command === CONTROL) {
      const good = (data & RANGE_MASK) === 0 && (data & CLEAR_AND_POWER_UP) === BOTH_MIDDLE && data & OWN_REFERENCE;
      if (!good) this.told(`its control register becomes ${data.toString(16)}`);
      this.ready = true;
    } else if (command === WRITE_AND_UPDATE) {
      if (this.ready) this.code = data;
    } else {
      this.told(`command ${command}`);
    }
  }
}

module.exports = { Converter };
