'use strict';
/* The emulated board on a USB bus, and what every host does with a device that has been plugged in. */
const { Pico } = require('./pico.js');
const { Bus, setup } = require('./usb_bus.js');

class UsbPico extends Pico {
  load(state) {
    super.load(state);
    this.bus = new Bus(this.chip);
  }

  /* Let time pass until `done` has been called; returns what it was called with. */
  wait(begin, most = 1e9) {
    let answer = null;
    begin((...what) => (answer = what));
    const ends = this.now + most;
    while (answer === null) {
      if (this.now > ends) throw new Error('nothing came of it in ' + most / 1e6 + ' ms');
      this.runUntil(this.now + 1000);
    }
    return answer;
  }

  control(kind, request, value, index, lengthOrData) {
    const data = Buffer.isBuffer(lengthOrData) ? lengthOrData : null;
    const length = data ? data.length : lengthOrData;
    const bytes = setup(kind, request, value, index, length);
    const [status, answer] = this.wait((done) => this.bus.submit({ setup: bytes, data, done }));
    return { status, data: answer };
  }

  /* Bus reset, address, configuration. */
  enumerate(address = 7) {
    while (!this.bus.seen) this.runUntil(this.now + 10000);
    this.wait((done) => this.bus.reset(done));
    this.runUntil(this.now + 2e6);
    const device = this.control(0x80, 6, 0x100, 0, 18);
    this.control(0, 5, address, 0, 0);
    const head = this.control(0x80, 6, 0x200, 0, 9).data;
    const configuration = this.control(0x80, 6, 0x200, 0, head.readUInt16LE(2)).data;
    const configured = this.control(0, 9, configuration[5], 0, 0);
    return { device: device.data, configuration, status: configured.status, address: this.bus.device.get(0) };
  }
}

module.exports = { UsbPico };
