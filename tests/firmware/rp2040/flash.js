'use strict';
/* The controller of the serial flash (data sheet 4.10) as far as the program uses it once it runs: bytes out and in at the
 * same time, of which the flash knows one command, Read Unique ID. */
const CONTROL = 0x00;
const ENABLE = 0x08;
const SELECT = 0x10;
const BAUD = 0x14;
const RECEIVED = 0x24;
const DATA = 0x60;
const BYTES_BOTH_WAYS = 7 << 16;
const QUEUE = 16;
const READ_UNIQUE_ID = 0x4b;
const ID_BEGINS = 5;

class Flash {
  constructor(id, told) {
    this.id = Buffer.from(id, 'hex');
    this.told = told; // what the controller does not allow
    this.registers = {};
    this.sent = [];
    this.received = [];
  }

  get divider() {
    return this.registers[BAUD] || 1;
  }

  readUint32(offset) {
    if (offset === RECEIVED) return this.received.length;
    if (offset === DATA) return this.received.shift() || 0;
    return this.registers[offset] || 0;
  }

  writeUint32Atomic(offset, value) {
    if (offset === DATA) {
      if (this.sent.push(value & 0xff) > QUEUE) this.told('its queue is full');
    } else {
      if (this.registers[ENABLE] && [CONTROL, BAUD].includes(offset)) this.told('changed while it is on');
      this.registers[offset] = value;
    }
    if (this.registers[ENABLE] && this.registers[SELECT] && this.registers[CONTROL] === BYTES_BOTH_WAYS) this.move();
  }

  /* All bytes that wait, while the flash is selected. */
  move() {
    const answer = (i) => (this.sent[0] === READ_UNIQUE_ID && i >= ID_BEGINS ? this.id[i - ID_BEGINS] : 0xff);
    this.received.push(...this.sent.map((_, i) => answer(i)));
    this.sent = [];
  }
}

module.exports = { Flash };
