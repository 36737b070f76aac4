'use strict';
/* A PL011 at the pace of its line (RP2040 data sheet, 4.2): FIFOs of 32 bytes, DMA requests, overruns. The emulator's own takes
 * any number of bytes in no time, which would prove nothing about a stream. */
const FIFO_BYTES = 32;
const BITS_A_BYTE = 10;
const DREQ_TRANSMIT = 20;
const DREQ_RECEIVE = 21;
const DR = 0x00, FR = 0x18, IBRD = 0x24, FBRD = 0x28, LCR_H = 0x2c, CR = 0x30, DMACR = 0x48;
const FR_TXFE = 0x80, FR_RXFF = 0x40, FR_TXFF = 0x20, FR_RXFE = 0x10, FR_BUSY = 0x08;

class Uart {
  constructor(rp2040) {
    this.rp2040 = rp2040;
    this.registers = new Map();
    this.divider = 0;
    this.transmit = [];
    this.shifting = null;
    this.receive = [];
    this.coming = []; // of the host, not yet on the line
    this.sent = []; // what the host has got
    this.overruns = 0; // bytes that found the FIFO full, either way
    this.lineFree = 0; // ns
    this.sendAlarm = rp2040.clock.createAlarm(() => this.byteSent());
    this.receiveAlarm = rp2040.clock.createAlarm(() => this.byteReceived());
  }

  clkPeriChanged() {}

  get baud() {
    return this.rp2040.clkPeri / (16 * this.divider);
  }

  get byteNanos() {
    return (BITS_A_BYTE * 1e9) / this.baud;
  }

  get on() {
    return (this.registers.get(CR) & 1) !== 0;
  }

  /* The host's bytes; its line has the same rate. */
  feed(bytes) {
    const idle = this.coming.length === 0;
    for (const byte of bytes) this.coming.push(byte);
    if (idle && this.coming.length > 0) this.receiveAlarm.schedule(this.byteNanos);
  }

  byteReceived() {
    const byte = this.coming.shift();
    if (this.on) {
      if (this.receive.length < FIFO_BYTES) this.receive.push(byte);
      else this.overruns++;
      this.request();
    }
    if (this.coming.length > 0) this.receiveAlarm.schedule(this.byteNanos);
  }

  byteSent() {
    this.sent.push(this.shifting);
    this.shifting = null;
    this.shift();
    this.request();
  }

  shift() {
    if (this.shifting === null && this.transmit.length > 0) {
      this.shifting = this.transmit.shift();
      this.sendAlarm.schedule(this.byteNanos);
    }
  }

  request() {
    const { dma } = this.rp2040;
    const wanted = this.registers.get(DMACR) || 0;
    if (wanted & 1 && this.receive.length > 0) dma.setDREQ(DREQ_RECEIVE);
    else dma.clearDREQ(DREQ_RECEIVE);
    if (wanted & 2 && this.on && this.transmit.length < FIFO_BYTES) dma.setDREQ(DREQ_TRANSMIT);
    else dma.clearDREQ(DREQ_TRANSMIT);
  }

  readUint32(offset) {
    switch (offset) {
      case DR: {
        const byte = this.receive.length > 0 ? this.receive.shift() : 0;
        this.request();
        return byte;
      }
      case FR:
        return (
          (this.transmit.length === 0 ? FR_TXFE : 0) |
          (this.receive.length === FIFO_BYTES ? FR_RXFF : 0) |
          (this.transmit.length === FIFO_BYTES ? FR_TXFF : 0) |
          (this.receive.length === 0 ? FR_RXFE : 0) |
          (this.shifting !== null ? FR_BUSY : 0)
        );
      default:
        return this.registers.get(offset) || 0;
    }
  }

  writeUint32(offset, value) {
    if (offset === DR) {
      if (this.transmit.length < FIFO_BYTES) this.transmit.push(value & 0xff);
      else this.overruns++;
      this.shift();
    } else {
      this.registers.set(offset, value);
      if (offset === LCR_H) this.divider = this.registers.get(IBRD) + this.registers.get(FBRD) / 64;
    }
    this.request();
  }

  writeUint32Atomic(offset, value, kind) {
    const now = this.registers.get(offset) || 0;
    const after = [value, now ^ value, now | value, now & ~value][kind];
    this.writeUint32(offset, after >>> 0);
  }
}

module.exports = { Uart };
