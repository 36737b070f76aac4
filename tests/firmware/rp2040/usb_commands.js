'use strict';
/* What serve.js understands of USB: a host that has the device's bulk pipes open, as `rig` has. */
const TRANSFERS = 4; // kept queued, each of so many bytes
const TRANSFER_BYTES = 4096;

module.exports = (board) => {
  let got = [];
  let broken = [];
  let listening = 0;

  const listen = (bus, endpoint) => {
    const done = (status, data) => {
      if (data.length > 0) got.push(data);
      if (status === 0) listen(bus, endpoint);
      else broken.push(status);
    };
    bus.submit({ endpoint, in: true, length: TRANSFER_BYTES, done });
  };

  const taken = () => {
    const data = Buffer.concat(got);
    got = [];
    return { hex: data.toString('hex'), now: board().now, broken };
  };

  return {
    /* Plug in, enumerate, open a pipe. */
    usb_plug({ endpoint = 1 }) {
      const { device, configuration, status, address } = board().enumerate();
      got = [];
      broken = [];
      listening = endpoint;
      if (endpoint > 0) for (let i = 0; i < TRANSFERS; i++) listen(board().bus, endpoint);
      return { device: device.toString('hex'), configuration: configuration.toString('hex'), status, address };
    },
    usb_control({ kind, request, value, index, length }) {
      const { status, data } = board().control(kind, request, value, index, length);
      return { status, hex: data.toString('hex') };
    },
    usb_send({ hex, endpoint = listening }) {
      const done = (status) => status !== 0 && broken.push(status);
      board().bus.submit({ endpoint, in: false, data: Buffer.from(hex, 'hex'), done });
      return {};
    },
    /* Let so many microseconds pass, or fewer: until something has come. */
    usb_run({ us, first = false }) {
      const pico = board();
      const ends = pico.now + us * 1000;
      while (pico.now < ends && !(first && got.length > 0)) pico.runUntil(Math.min(ends, pico.now + 10000));
      return taken();
    },
    /* Ask for a descriptor and take that back after so many microseconds: what the transfer and its withdrawal are told. */
    usb_withdraw({ us, after }) {
      const pico = board();
      const told = [];
      const setup = Buffer.from([0x80, 6, 0, 1, 0, 0, 18, 0]);
      const transfer = pico.bus.submit({ setup, done: (status, data) => told.push(['done', status, data.length]) });
      pico.runUntil(pico.now + us * 1000);
      pico.bus.withdraw(transfer, (withdrawn) => told.push(['withdrawn', withdrawn]));
      pico.runUntil(pico.now + after * 1000);
      return { told };
    },
    usb_suspend({ asleep }) {
      board().bus.suspend(asleep);
      return {};
    },
    usb_look() {
      const { counts, errors } = board().bus;
      return { ...counts, errors, waiting: board().bus.waiting.length };
    },
  };
};
