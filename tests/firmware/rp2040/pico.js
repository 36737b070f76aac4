'use strict';
/* A Raspberry Pi Pico with a motor, an encoder and a serial line, cycle by cycle.
 *
 * The processor, DMA, PWM, ADC, timers and the state machines of PIO are rp2040js'. What it lacks for this purpose is here:
 * one clock for processor and PIO, PIO's delays where the tests look at them, cycles of an exception's entry and return, a wake-up by any timer, a UART that takes
 * time, reset by the watchdog, the boot ROM's way into a program. */
const { RP2040 } = require('rp2040js');
const { ConsoleLogger, LogLevel } = require('rp2040js');
const { Converter } = require('./dac.js');
const { Flash } = require('./flash.js');
const { Uart } = require('./uart.js');

/* Armv6-M without wait states (Cortex-M0+ Technical Reference Manual, 3.3 and 3.6). The emulator takes none. */
const EXCEPTION_ENTRY = 15;
const EXCEPTION_RETURN = 13;
const TICK_EXCEPTION = 16 + 4; // PWM_IRQ_WRAP
const BOOT2_BYTES = 256;
const BOOT2_AT = 0x20041f00; // where the boot ROM puts it (RP2040 data sheet, 2.8.1.3.1)
/* As much of the boot ROM as the program asks for (2.8.3): where its table and its search are; the search, which knows
 * reset_to_usb_boot alone; and that, which stands still. */
const BOOT_ROM = { 0x14: 0x0080, 0x18: 0x0041, 0x40: 0x42914a02, 0x44: 0x2061d101, 0x48: 0xe7fe4770, 0x4c: 0x4255, 0x60: 0xe7fe };
const USB_BOOT = 0x60;
const FLASH_AT = 0x10000000;
const FLASH_ENDS = 0x11000000;
const LINE_BYTES = 8; // of the flash's cache
const WORD_BITS = 64; // on the flash's line for a word of 32: command, address, data
const REGULATES_NS = 50000;
const PIO_RESTS = 32; // cycles after an edge in which the state machines have come to rest
const GUARD_LOOP = 3; // cycles of the only machine that never waits
const PIO1 = 7; // function of a pin
const PIO_INSTRUCTIONS = [0xd8, 0xf0, 0x108, 0x120];

class Quiet {
  constructor(told) {
    this.told = told;
  }
  debug() {}
  info() {}
  warn(part, text) {
    this.told(`${part}: ${text}`);
  }
  error(part, text) {
    this.told(`${part}: ${text}`);
  }
}

/* Levels of all pins are kept, not asked of thirty pins whenever a state machine looks. A property of the class: one of each chip
 * would give each a shape of its own, and code that has met two shapes is half as quick. */
class Chip extends RP2040 {
  get gpioValues() {
    return this.levels;
  }
}

class Pico {
  /* `image`: the flash; `pins`: which GPIO is what, as in board.toml; `waits`: whether flash and crystal take their time, which
   * is most of a boot; `flash`: its unique number, 16 hexadecimal digits. */
  constructor(image, pins, { waits = false, flash }) {
    this.image = image;
    this.waits = waits;
    this.flash = flash;
    this.pins = pins;
    this.complaints = new Map(); // of the emulator: what it does not know
    this.resets = 0;
    this.switches = { hold_to_run: true, emergency_stop: false, sync: false };
    this.phase = 0; // of the encoder, quarters of a line
    this.truth = 0; // counts
    this.settled = 0; // before the last of them, which the state machines see some cycles later
    this.elapsed = 0; // ns, over all resets
    this.unplugged = false; // the encoder: the pull-ups hold all lines high
    this.broken = [false, false]; // lines A and B, which the pull-ups hold high then
    this.marks = { every: 0, pressed: null }; // counts between two indices; count up to which the limit switch is pressed
    this.indexed = false;
    this.edges = []; // { at, way }: to come, rising
    this.contact = true; // of the dead-man switch, in the wire from enable to the converter's RESET
    this.onReset = () => {};
    this.motor = null; // what else lives in this time, before each instruction
    this.load({});
  }

  /* Power-up, or what the watchdog leaves: everything anew but the flash, and the watchdog's own memory. */
  load({ reason = 0, scratch = null }) {
    const chip = new Chip();
    this.chip = chip;
    chip.logger = new Quiet((text) => this.complaints.set(text, (this.complaints.get(text) || 0) + 1));
    chip.flash.set(this.image);
    chip.sram.fill(0xa5); // as found after power-up: anything
    this.uart = new Uart(chip);
    chip.uart[0] = chip.peripherals[0x40034] = this.uart;
    chip.clkSys = chip.roscFreq;
    for (const [at, word] of Object.entries(BOOT_ROM)) chip.bootrom[at / 4] = word;
    chip.peripherals[0x18000] = new Flash(this.flash, (text) => chip.logger.warn('SSI', text));
    this.powerSupply();
    this.stall = 0; // cycles that an instruction has waited for the flash
    if (this.waits) this.takeTime();
    this.watchdog = chip.peripherals[0x40058];
    this.watchdog.reason = reason;
    if (scratch) this.watchdog.scratchData.set(scratch);
    this.bitten = false;
    this.watchdog.onWatchdogTrigger = () => {
      this.bitten = true;
      this.watchdog.alarm.enable = false; // the emulator's would strike again in no time
    };
    chip.levels = 0;
    this.watchPads();
    this.watchPwm();
    this.watchPio();
    this.watchConverter();
    this.showSwitches();
    this.showEncoder();
    this.showMarks();
    this.born = this.elapsed;
    this.cycles = 0;
    this.turned = -PIO_RESTS;
    this.clear();
    chip.gpio[this.pins.sync_out].addListener((state) => this.syncChanged(state));
    this.boot();
  }

  /* The regulator (data sheet 2.10.6), which a reset of the chip leaves alone: 1.10 V, on; in regulation a while after
   * each change. When it was changed last before the processor became fast, and what for. */
  powerSupply() {
    const { chip } = this;
    const regulator = (this.regulator = this.regulator || { value: 0xb1 });
    regulator.changed = this.elapsed;
    chip.peripherals[0x40064] = {
      readUint32: () => regulator.value | (this.now - regulator.changed > REGULATES_NS ? 0x1000 : 0),
      writeUint32Atomic: (offset, value) => {
        regulator.value = value;
        regulator.changed = this.now;
      },
    };
    this.settled = 0;
    chip.addClockListener((frequency) => {
      if (frequency > chip.xoscFreq) this.settled = this.now - regulator.changed;
    });
  }

  /* The crystal is stable when its delay is over (2.16.3), and what the cache has not read yet takes its bits on the flash's
   * line, at the processor's clock divided by BAUDR. */
  takeTime() {
    const { chip } = this;
    const oscillator = chip.peripherals[0x40024];
    const write = oscillator.writeUint32.bind(oscillator);
    const read = oscillator.readUint32.bind(oscillator);
    let ready = 0;
    oscillator.writeUint32 = (offset, value) => {
      if (offset === 0) ready = this.now + ((oscillator.startup * 256) / chip.xoscFreq) * 1e9;
      write(offset, value);
    };
    oscillator.readUint32 = (offset) => {
      oscillator.stable = oscillator.enabled && this.now >= ready;
      return read(offset);
    };
    const flash = chip.peripherals[0x18000];
    const cached = new Set();
    for (const name of ['readUint32', 'readUint16', 'readUint8']) {
      const from = chip[name].bind(chip);
      chip[name] = (address) => {
        if (address >= FLASH_AT && address < FLASH_ENDS) {
          const line = Math.floor(address / LINE_BYTES);
          if (!cached.has(line)) this.stall += (LINE_BYTES / 4) * WORD_BITS * flash.divider;
          cached.add(line);
        }
        return from(address);
      };
    }
  }

  /* Whether the boot ROM shows its drive. */
  get inBootloader() {
    return this.chip.core.PC === USB_BOOT;
  }

  /* What the boot ROM does with a flash that it accepts. */
  boot() {
    const { chip } = this;
    chip.sram.set(this.image.subarray(0, BOOT2_BYTES), BOOT2_AT - 0x20000000);
    const { core } = chip;
    core.registers[13] = 0x20041f00;
    core.registers[14] = 0;
    core.PC = BOOT2_AT;
  }

  get now() {
    return this.born + this.chip.clock.nanos;
  }

  /* ---------------------------------------------------------------- wires into the chip */

  setPin(pin, level) {
    const { chip } = this;
    const gpio = chip.gpio[pin];
    gpio.setInputValue(level);
    const bit = 1 << pin;
    chip.levels = gpio.inputValue ? chip.levels | bit : chip.levels & ~bit;
  }

  showSwitches() {
    // Contacts to ground: held closes one, pressed opens the other.
    this.setPin(this.pins.hold_to_run, !this.switches.hold_to_run);
    this.setPin(this.pins.emergency_stop, this.switches.emergency_stop);
    this.setPin(this.pins.sync_in, this.switches.sync);
    this.wake();
  }

  showEncoder() {
    const a = this.phase === 1 || this.phase === 2;
    const b = this.phase === 2 || this.phase === 3;
    const lines = [a, b].map((level, i) => (this.unplugged ? [true, true] : [level || this.broken[i], !level]));
    lines.forEach(([line, complement], i) => {
      this.setPin(this.pins.encoder + i, line);
      this.setPin(this.pins.encoder_complement + i, complement);
    });
    this.wake();
  }

  /* Move the encoder by `way` counts at once: more than one is what no encoder does. */
  turn(way) {
    this.phase = (this.phase + way) & 3;
    this.settled = this.truth;
    this.turned = this.cycles;
    this.truth += way;
    this.showEncoder();
    this.showMarks();
  }

  /* The index is as wide as a count, and one of them is count zero. The switch's contact to ground opens when it is pressed. */
  showMarks() {
    const { every, pressed } = this.marks;
    const indexed = every > 0 && this.truth % every === 0;
    if (indexed !== this.indexed) this.setPin(this.pins.encoder_index, indexed);
    this.indexed = indexed;
    this.setPin(this.pins.limit_switch, pressed !== null && this.truth <= pressed);
  }

  watchPads() {
    const pads = this.chip.peripherals[0x4001c];
    const write = pads.writeUint32.bind(pads);
    pads.writeUint32 = (offset, value) => {
      write(offset, value);
      for (let pin = 0; pin < 30; pin++) this.setPin(pin, this.chip.gpio[pin].rawInputValue);
    };
  }

  /* A counter shows whole counts that are over; the emulator's rounds to the nearest, and is at zero before it has wrapped. */
  watchPwm() {
    const COUNTER = 8;
    for (const channel of this.chip.pwm.channels) {
      const read = channel.readRegister.bind(channel);
      channel.readRegister = (offset) => {
        const { timer } = channel;
        if (offset !== COUNTER || !timer.enable) return read(offset);
        const counts = ((this.chip.clock.nanos - timer.baseNanos) / 1e9) * (timer.frequency / timer.prescaler);
        return Math.floor(timer.baseValue + counts + 1e-6) % (timer.top + 1);
      };
    }
  }

  /* ---------------------------------------------------------------- PIO on the chip's own clock */

  watchPio() {
    const pio = this.chip.pio[0];
    pio.run = () => {};
    const write = pio.writeUint32.bind(pio);
    pio.writeUint32 = (offset, value) => {
      if (offset === PIO_INSTRUCTIONS[0] && (value & 0xffff) === 0x4020)
        // The processor begins to read the count.
        this.before = this.cycles - this.turned < PIO_RESTS ? this.settled : this.truth;
      write(offset, value);
      if (offset === PIO_INSTRUCTIONS[1] && (value & 0xffff) === 0x4040 && this.inTick) this.counted();
      this.wake();
    };
    this.awake = 0;
    this.slept = 0;
  }

  wake() {
    this.awake = PIO_RESTS;
  }

  stepPio() {
    const { machines } = this.chip.pio[0];
    for (let i = 0; i < 4; i++) if (machines[i].enabled) machines[i].step();
  }

  /* The machine that feeds the converter, in PIO 1: with delays, the clock's divider, and pins. */
  watchConverter() {
    const pio = this.chip.pio[1];
    pio.run = () => {};
    this.converter = new Converter((text) => this.chip.logger.warn('converter', text));
    this.outputHangs = false;
    this.outputCycles = 0; // of the machine
    this.divided = 0;
    this.chip.gpio[this.pins.enable].addListener(() => this.showReset());
  }

  get heard() {
    return this.enabled && this.contact;
  }

  showReset() {
    if (!this.heard) this.converter.reset();
  }

  /* A machine that does not run does not wait for words either. */
  hangOutput() {
    this.outputHangs = true;
    this.chip.pio[1].txStall = 0;
  }

  advanceOutput(from, cycles, nanos) {
    const pio = this.chip.pio[1];
    const machine = pio.machines[0];
    if (!machine.enabled || this.outputHangs) return;
    if (machine.waiting && machine.txFIFO.empty) return;
    const pin = this.pins.dac;
    for (let i = 0; i < cycles; i++) {
      if (++this.divided % machine.clockDivInt !== 0) continue;
      if (++this.outputCycles < machine.cycles) continue; // a delay
      machine.step();
      if (machine.waiting) this.outputCycles = machine.cycles;
      const levels = [0, 1, 2].map((i) => this.level(pin + i));
      this.converter.see(...levels, from + (i + 1) * nanos, this.heard);
    }
  }

  /* Let the state machines live through some cycles; at rest only the guard turns, in circles. */
  advancePio(from, cycles, nanos) {
    const { edges } = this;
    if (this.awake === 0 && (edges.length === 0 || edges[0].at > from + cycles * nanos)) {
      this.slept += cycles;
      return;
    }
    for (let i = 0; i < cycles; i++) {
      const at = from + i * nanos;
      while (edges.length > 0 && edges[0].at <= at) this.turn(edges.shift().way);
      if (this.awake > 0) {
        for (; this.slept % GUARD_LOOP !== 0; this.slept--) this.stepPio();
        this.slept = 0;
        this.awake--;
        this.stepPio();
      } else {
        this.slept++;
      }
    }
  }

  /* ---------------------------------------------------------------- what is measured */

  clear() {
    this.ticks = []; // { came, at, ends, entered, left, before, after }: ns; cycles since reset; counts of the encoder
    this.inTick = false;
    this.tick = null;
    this.entered = 0;
    this.held = this.longestHeld = 0; // interrupts masked, cycles
  }

  syncChanged(state) {
    const high = state === 1;
    if (high === this.inTick) return;
    this.inTick = high;
    if (high) {
      this.tick = { came: this.now, at: this.cycles, ends: 0, entered: this.entered, left: 0, before: 0, after: 0 };
      this.ticks.push(this.tick);
    } else if (this.tick) {
      this.tick.ends = this.cycles;
    }
  }

  /* The ticks that are over, once. */
  takeTicks() {
    const over = this.ticks.filter((tick) => tick.left > 0);
    this.ticks = this.ticks.filter((tick) => tick.left === 0);
    return over;
  }

  counted() {
    this.tick.before = this.before;
    this.tick.after = this.truth;
  }

  /* ---------------------------------------------------------------- the run loop */

  step() {
    const { chip } = this;
    const { core, clock } = chip;
    let cycles;
    if (core.waiting) {
      cycles = 1;
      if (core.interruptsUpdated && core.checkForInterrupts()) core.waiting = false;
    } else {
      const before = core.IPSR;
      cycles = core.executeInstruction();
      const after = core.IPSR;
      if (before !== after) cycles += this.excepted(before, after, cycles);
      cycles += this.stall;
      this.stall = 0;
    }
    const from = this.now;
    const nanos = 1e9 / chip.clkSys;
    clock.tick(cycles * nanos);
    this.advancePio(from, cycles, nanos);
    this.advanceOutput(from, cycles, nanos);
    this.cycles += cycles;
    this.held = core.PM ? this.held + cycles : 0;
    if (this.held > this.longestHeld) this.longestHeld = this.held;
    if (this.bitten) this.bite();
  }

  /* Another exception runs than before this instruction: returns the cycles which that takes. */
  excepted(before, after, cycles) {
    if (before === 0 || after === TICK_EXCEPTION) {
      if (after === TICK_EXCEPTION) this.entered = this.cycles;
      return EXCEPTION_ENTRY;
    }
    if (before === TICK_EXCEPTION && this.tick) this.tick.left = this.cycles + cycles + EXCEPTION_RETURN;
    return EXCEPTION_RETURN;
  }

  bite() {
    this.elapsed = this.now;
    this.resets++;
    this.onReset();
    const { reason, scratchData } = this.watchdog;
    const { sent } = this.uart;
    this.load({ reason, scratch: scratchData.slice() });
    this.uart.sent = sent;
  }

  runUntil(nanos) {
    const { motor } = this;
    while (this.now < nanos) {
      if (motor !== null && motor.next <= this.now) motor.upTo(this.now);
      this.step();
    }
  }

  /* ---------------------------------------------------------------- wires out of the chip */

  /* Level of an output; one that nobody drives is pulled down, as reset leaves it. */
  level(pin) {
    const gpio = this.chip.gpio[pin];
    if (gpio.outputEnable) return gpio.outputValue;
    return gpio.pullupEnabled && !gpio.pulldownEnabled;
  }

  get enabled() {
    return this.level(this.pins.enable);
  }

  /* Share of full scale, -1 to 1: the converter's, or of the largest duty that magnitude and direction show (setting "sign"). */
  get share() {
    if (this.chip.gpio[this.pins.dac].functionSelect === PIO1) return this.converter.volts / 10;
    const gpio = this.chip.gpio[this.pins.pwm];
    if (gpio.functionSelect !== 4) return 0;
    const channel = this.chip.pwm.channels[(this.pins.pwm >> 1) & 7];
    const period = channel.timer.top + 1;
    const width = Math.min(channel.alarmA.target / period, 1);
    return channel.alarmB.target > 0 ? -width : width;
  }
}

module.exports = { Pico };
