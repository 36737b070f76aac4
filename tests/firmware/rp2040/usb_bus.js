'use strict';
/* The USB controller of an RP2040 as a device, and the bus with a host on its other side.
 *
 * It stands in the place of rp2040js' own, which lets an IN packet go when it is armed, has no toggles, no STALL, no frames
 * and one buffer. Mirrors the data sheet (4.1.2, 4.1.4) as usb_controller.c does, and the bus as USB 2.0 has it at full speed:
 * one transaction at a time, each as long as its bits take, frames of a millisecond that no transaction crosses. */

const INTERRUPT = 5;
const ENABLE = 0x80000000, TWO_BUFFERS = 0x40000000;
const FULL = 0x8000, DATA1 = 0x2000, SELECT_FIRST = 0x1000, STALL = 0x800, AVAILABLE = 0x400, LENGTH = 0x3ff;
const BUS_RESET = 1 << 19, SETUP = 1 << 17, RESUME = 1 << 11, SUSPENDED = 1 << 4;
const INT_SOF = 1 << 17, INT_SETUP = 1 << 16, INT_RESUME = 1 << 15, INT_SUSPEND = 1 << 14, INT_BUS_RESET = 1 << 12;
const INT_BUFFER = 1 << 4;
const PULL_UP = 1 << 16;

const PACKET = 64;
const FRAME = 1e6; // ns, as all times here
const RESET = 10e6;
const bits = (count) => Math.round((count * 1e9) / 12e6);
/* Sync, PID, CRC and end of packet of token, data and handshake, and the pauses in between; what is stuffed is left out. */
const DATA_OVERHEAD = bits(8 * 13);
const NAK_TIME = bits(8 * 8);
const LONGEST = DATA_OVERHEAD + bits(8 * PACKET);
const POLL = 3000; // until a host that was told NAK asks again

const ENDPOINT_OF_INTERFACE = [1, 3, 2]; // of our own device

const EPIPE = -32, EPROTO = -71, ECONNRESET = -104;

class Controller {
  constructor(chip, bus) {
    this.chip = chip;
    this.bus = bus;
    this.memory = chip.usbDPRAMView;
    this.registers = new Map();
    this.sieStatus = 0;
    this.buffStatus = 0;
    this.sof = false;
    this.select = [new Array(16).fill(0), new Array(16).fill(0)];
    this.level = false;
    this.watch(chip.core);
  }

  /* The NVIC latches an interrupt until it is taken, and again at its end while its line is up; rp2040js keeps it pending until
   * the line is down, and so one that the program pended for ever. */
  watch(core) {
    const bit = 1 << INTERRUPT;
    const enter = core.exceptionEntry.bind(core);
    const leave = core.exceptionReturn.bind(core);
    core.exceptionEntry = (number) => {
      enter(number);
      if (number === 16 + INTERRUPT) core.pendingInterrupts &= ~bit;
    };
    core.exceptionReturn = (value) => {
      leave(value);
      if (this.level) this.pend();
    };
  }

  pend() {
    const { core } = this.chip;
    core.pendingInterrupts |= 1 << INTERRUPT;
    core.interruptsUpdated = true;
    if (core.waiting && core.checkForInterrupts()) core.waiting = false;
  }

  get(offset) {
    return this.registers.get(offset) || 0;
  }

  get pending() {
    const of = (status, interrupt) => (this.sieStatus & status ? interrupt : 0);
    const raw =
      of(BUS_RESET, INT_BUS_RESET) | of(SETUP, INT_SETUP) | of(SUSPENDED, INT_SUSPEND) | of(RESUME, INT_RESUME) |
      (this.buffStatus ? INT_BUFFER : 0) | (this.sof ? INT_SOF : 0);
    return raw & this.get(0x90);
  }

  update() {
    const level = this.pending !== 0;
    if (level && !this.level) this.pend();
    this.level = level;
  }

  readUint32(offset) {
    switch (offset) {
      case 0x48:
        this.sof = false;
        this.update();
        return 0;
      case 0x50:
        return this.sieStatus >>> 0;
      case 0x58:
        return this.buffStatus >>> 0;
      case 0x64: // EP_ABORT_DONE: at once
        return this.get(0x60);
      case 0x98:
        return this.pending >>> 0;
      default:
        return this.get(offset);
    }
  }

  writeUint32Atomic(offset, value, type) {
    switch (offset) {
      case 0x50:
        this.sieStatus &= ~(value & ~SUSPENDED);
        break;
      case 0x58:
        this.buffStatus &= ~value;
        break;
      default: {
        const before = this.get(offset);
        this.registers.set(offset, type === 1 ? before ^ value : type === 2 ? before | value : type === 3 ? before & ~value : value);
      }
    }
    this.update();
    if (offset === 0x4c) this.bus.looked();
  }

  /* rp2040js calls this behind every write to the shared memory. */
  DPRAMUpdated(offset) {
    if (offset >= 0x80 && offset < 0x100) this.bus.looked();
  }

  get connected() {
    return (this.get(0x40) & 1) !== 0 && (this.get(0x4c) & PULL_UP) !== 0;
  }

  /* What a token of the host finds: { answer: 'data' | 'nak' | 'stall' | 'nobody', control, buffer, state }. */
  token(number, out) {
    let settings = 0x100;
    if (number > 0) {
      settings = this.memory.getUint32(8 * number + (out ? 4 : 0), true);
      if (!(settings & ENABLE)) return { answer: 'nobody' };
    }
    const at = 0x80 + 8 * number + (out ? 4 : 0);
    const first = this.memory.getUint16(at, true);
    const armed = number > 0 || this.get(0x68) & (out ? 2 : 1);
    if (first & STALL && armed) return { answer: 'stall' };
    const way = this.select[out ? 1 : 0];
    if (first & SELECT_FIRST && first & AVAILABLE) way[number] = 0;
    const second = number > 0 && settings & TWO_BUFFERS ? way[number] : 0;
    const control = at + 2 * second;
    const state = this.memory.getUint16(control, true);
    if (!(state & AVAILABLE) || !(state & FULL) !== out) return { answer: 'nak' };
    return { answer: 'data', control, buffer: (settings & 0xffc0) + 64 * second, state };
  }

  finish(number, out, found, count) {
    const kept = found.state & DATA1;
    this.memory.setUint16(found.control, kept | (out ? FULL : 0) | count, true);
    this.select[out ? 1 : 0][number] ^= 1;
    this.buffStatus |= 1 << (2 * number + (out ? 1 : 0));
    this.update();
  }

  setup(bytes) {
    this.chip.usbDPRAM.set(bytes, 0);
    this.registers.set(0x68, 0);
    this.sieStatus |= SETUP;
    this.update();
  }

  busReset() {
    this.sieStatus = (this.sieStatus & ~SUSPENDED) | BUS_RESET;
    this.update();
  }
}

class Bus {
  constructor(chip) {
    this.chip = chip;
    this.clock = chip.clock;
    this.device = new Controller(chip, this);
    chip.usbCtrl = chip.peripherals[0x50110] = this.device;
    this.waiting = []; // transfers, in the order in which they take turns
    this.toggles = new Map();
    this.under = null; // the transaction on the wires
    this.frameBegan = 0;
    this.running = false; // the host sends frames
    this.asleep = true; // nothing to be done until the device does something
    this.turn = this.clock.createAlarm(() => this.next());
    this.frames = this.clock.createAlarm(() => this.frame());
    this.resets = this.clock.createAlarm(() => this.endReset());
    this.errors = []; // toggles out of step, packets that do not fit
    this.counts = { frames: 0, naks: 0, in: 0, out: 0, bytesIn: 0, bytesOut: 0, empty: 0 };
    this.onConnected = () => {};
    this.onReset = null;
    this.seen = false;
  }

  /* ------------------------------------------------------------------ what the host asks for */

  reset(done) {
    this.running = false;
    this.onReset = done;
    this.toggles.clear();
    this.device.busReset();
    this.resets.schedule(RESET);
  }

  endReset() {
    this.running = true;
    this.frame();
    const done = this.onReset;
    this.onReset = null;
    if (done) done();
  }

  /* { endpoint, in, length | data, done(status, data) }, { setup, data, done } for endpoint 0. Returns it. */
  submit(transfer) {
    transfer.moved = 0;
    transfer.got = [];
    if (transfer.setup) {
      transfer.endpoint = 0;
      transfer.stage = 'setup';
      const view = Buffer.from(transfer.setup);
      transfer.in = (view[0] & 0x80) !== 0;
      transfer.length = view.readUInt16LE(6);
    }
    this.waiting.push(transfer);
    this.looked();
    return transfer;
  }

  /* Take a transfer back. A transaction of it that is on the wires cannot be: it ends first, and may end the transfer as it
   * should. `ended` is called behind `done` and told whether the transfer was withdrawn. */
  withdraw(transfer, ended = () => {}) {
    if (this.under && this.under.transfer === transfer) {
      transfer.withdrawn = ended;
      return;
    }
    const waits = this.waiting.includes(transfer);
    if (waits) this.end(transfer, ECONNRESET);
    ended(waits);
  }

  end(transfer, status) {
    const at = this.waiting.indexOf(transfer);
    if (at >= 0) this.waiting.splice(at, 1);
    transfer.done(status, Buffer.concat(transfer.got));
  }

  /* The host's computer goes to sleep, or wakes. */
  suspend(asleep) {
    this.running = !asleep;
    if (asleep) this.frames.cancel();
    else this.frame();
    const { device } = this;
    device.sieStatus = asleep ? device.sieStatus | SUSPENDED : (device.sieStatus & ~SUSPENDED) | RESUME;
    device.update();
  }

  /* ------------------------------------------------------------------ time */

  frame() {
    if (!this.running) return;
    this.frameBegan = this.clock.nanos;
    this.frames.schedule(FRAME);
    this.counts.frames++;
    if (this.device.connected) {
      this.device.sof = true;
      this.device.update();
    }
    this.looked();
  }

  /* Something may be possible now that was not before. */
  looked() {
    if (this.device.connected && !this.seen) {
      this.seen = true;
      this.onConnected();
    }
    if (this.under || !this.asleep || this.waiting.length === 0) return;
    this.asleep = false;
    this.turn.schedule(POLL);
  }

  /* One transaction, of whoever's turn it is; those that were told NAK are asked again when something has happened. */
  next() {
    if (this.under) this.finish();
    if (!this.running) {
      this.asleep = true;
      return;
    }
    if (this.clock.nanos + LONGEST > this.frameBegan + FRAME) {
      this.asleep = true; // the next frame wakes us
      return;
    }
    const active = new Set(); // one transfer of a pipe at a time
    for (let i = 0; i < this.waiting.length; i++) {
      const transfer = this.waiting[i];
      const pipe = transfer.endpoint * 2 + (transfer.endpoint && transfer.in ? 1 : 0);
      if (active.has(pipe)) continue;
      active.add(pipe);
      const transaction = this.attempt(transfer);
      if (transaction) {
        this.under = transaction;
        this.turn.schedule(transaction.takes);
        return;
      }
      this.counts.naks++;
    }
    this.asleep = true;
  }

  /* The transaction is over: what it moved has moved. */
  finish() {
    const { transfer, ends } = this.under;
    this.under = null;
    const status = ends();
    const { withdrawn } = transfer;
    if (status === null && !withdrawn) {
      // to the end of the row, but before others of its pipe
      const at = this.waiting.indexOf(transfer);
      const same = (other) => other !== transfer && other.endpoint === transfer.endpoint && other.in === transfer.in;
      if (!this.waiting.some(same)) this.waiting.push(this.waiting.splice(at, 1)[0]);
      return;
    }
    this.end(transfer, status === null ? ECONNRESET : status);
    if (withdrawn) withdrawn(status === null);
  }

  /* ------------------------------------------------------------------ transactions */

  attempt(transfer) {
    if (transfer.stage === 'setup') {
      const ends = () => {
        this.device.setup(transfer.setup);
        transfer.stage = transfer.length === 0 ? 'status' : 'data';
        this.toggles.set(0, 1);
        this.toggles.set(0x80, 1);
        return null;
      };
      return { transfer, takes: DATA_OVERHEAD + bits(64), ends };
    }
    if (transfer.stage === 'status') {
      const out = transfer.in && transfer.length > 0;
      this.toggles.set(out ? 0 : 0x80, 1);
      return this.packet(transfer, out, Buffer.alloc(0), () => {
        transfer.stage = 'done';
        this.followed(transfer);
        return 0;
      });
    }
    if (transfer.in) return this.packet(transfer, false, null, (data) => this.arrived(transfer, data));
    const data = transfer.data.subarray(transfer.moved, transfer.moved + PACKET);
    return this.packet(transfer, true, data, () => {
      transfer.moved += data.length;
      if (transfer.moved < transfer.data.length) return null;
      if (transfer.endpoint > 0) return 0;
      transfer.stage = 'status';
      return null;
    });
  }

  arrived(transfer, data) {
    transfer.got.push(data);
    transfer.moved += data.length;
    const whole = transfer.moved >= transfer.length || data.length < PACKET;
    if (!whole) return null;
    if (transfer.endpoint > 0) return 0;
    transfer.stage = 'status';
    return null;
  }

  packet(transfer, out, data, moved) {
    const { endpoint } = transfer;
    const address = endpoint | (out ? 0 : 0x80);
    const found = this.device.token(endpoint, out);
    if (found.answer === 'nak') return null;
    if (found.answer !== 'data')
      return { transfer, takes: NAK_TIME, ends: () => (found.answer === 'stall' ? EPIPE : EPROTO) };
    const toggle = found.state & DATA1 ? 1 : 0;
    const expected = this.toggles.get(address) || 0;
    if (toggle !== expected) this.errors.push(`toggle of ${address.toString(16)} is ${toggle}`);
    const count = out ? data.length : found.state & LENGTH;
    if (out && count > (found.state & LENGTH)) this.errors.push(`${count} bytes do not fit into ${address}`);
    const ends = () => {
      this.toggles.set(address, expected ^ 1);
      const memory = this.chip.usbDPRAM;
      let packet = data;
      if (out) memory.set(data, found.buffer);
      else packet = Buffer.from(memory.slice(found.buffer, found.buffer + count));
      this.device.finish(endpoint, out, found, count);
      if (endpoint > 0) {
        this.counts[out ? 'out' : 'in']++;
        this.counts[out ? 'bytesOut' : 'bytesIn'] += count;
        if (count === 0) this.counts.empty++;
      }
      return moved(packet);
    };
    return { transfer, takes: DATA_OVERHEAD + bits(8 * count), ends };
  }

  /* What a host does with its own toggles when a request has been answered. */
  followed({ setup }) {
    const request = Buffer.from(setup);
    const [kind, number] = request;
    if (kind === 0 && number === 9) this.toggles.clear();
    if (kind === 1 && number === 11) {
      const pipe = ENDPOINT_OF_INTERFACE[request.readUInt16LE(4)];
      this.toggles.delete(pipe);
      this.toggles.delete(pipe | 0x80);
    }
    if (kind === 2 && number === 1) this.toggles.set(request.readUInt16LE(4), 0);
  }
}

const setup = (kind, request, value, index, length) => {
  const bytes = Buffer.alloc(8);
  bytes.writeUInt8(kind, 0);
  bytes.writeUInt8(request, 1);
  bytes.writeUInt16LE(value, 2);
  bytes.writeUInt16LE(index, 4);
  bytes.writeUInt16LE(length, 6);
  return bytes;
};

module.exports = { Bus, setup, ECONNRESET };
