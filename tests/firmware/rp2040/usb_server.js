'use strict';
/* The emulated board behind a socket, as a USB/IP server has it after OP_REP_IMPORT (Documentation/usb/usbip_protocol.rst of
 * the kernel): whoever attaches it to vhci_hcd sees the firmware's own USB registers.
 *
 * node usb_server.js SETTINGS: JSON with image, pins, motor (as serve.js), socket, status (a file that says now and then how the
 * board is) and pace (time of the board in that of the world, at most). Ends with its standard input. */
const fs = require('node:fs');
const net = require('node:net');
const { UsbPico } = require('./usb_pico.js');
const { Motor } = require('./motor.js');
const { ECONNRESET } = require('./usb_bus.js');

const SUBMIT = 1, UNLINK = 2, SUBMITTED = 3, UNLINKED = 4;
const HEAD = 48;
const SLICE = 500e3; // ns of the board, then whoever waits is asked
const BEHIND = 20e6; // ns of the board that are made up for; more are forgotten
const STATUS_EVERY = 100; // ms
const PATIENCE = 3e3; // ms without a message of the host, then the board's time stands still until the next one

const settings = JSON.parse(fs.readFileSync(process.argv[2], 'utf8'));
const pico = new UsbPico(fs.readFileSync(settings.image), settings.pins, settings);
const motor = new Motor(pico, settings.motor);
pico.motor = motor;
const { bus } = pico;
let peer = null;
let urbs = 0;
let strongest = 0;

/* ------------------------------------------------------------------ messages */

class Peer {
  constructor(socket) {
    this.socket = socket;
    this.received = Buffer.alloc(0);
    this.pending = new Map(); // sequence number: transfer
    socket.on('data', (data) => {
      hear();
      this.received = Buffer.concat([this.received, data]);
      while (this.take());
    });
    const gone = () => {
      for (const transfer of [...this.pending.values()]) bus.withdraw(transfer);
      if (peer === this) peer = null;
    };
    socket.on('close', gone);
    socket.on('error', gone);
  }

  take() {
    const { received } = this;
    if (received.length < HEAD) return false;
    const [command, sequence, , directionIn, endpoint] = [0, 4, 8, 12, 16].map((at) => received.readUInt32BE(at));
    const length = received.readInt32BE(24);
    const sent = command === SUBMIT && !directionIn ? length : 0;
    if (received.length < HEAD + sent) return false;
    const setup = received.subarray(40, 48);
    const data = received.subarray(HEAD, HEAD + sent);
    const other = received.readUInt32BE(20);
    this.received = received.subarray(HEAD + sent);
    if (command === UNLINK) this.unlink(sequence, other);
    else this.submit(sequence, endpoint, Boolean(directionIn), length, Buffer.from(setup), Buffer.from(data));
    return true;
  }

  submit(sequence, endpoint, isIn, length, setup, data) {
    const done = (status, got) => {
      this.pending.delete(sequence);
      if (status === ECONNRESET) return;
      urbs++;
      const moved = isIn ? got.length : status === 0 ? data.length : 0;
      this.answer(sequence, status, moved, isIn ? got : Buffer.alloc(0));
    };
    const transfer = endpoint === 0 ? { setup, data, done } : { endpoint, in: isIn, length, data, done };
    this.pending.set(sequence, transfer);
    bus.submit(transfer);
  }

  /* Its answer follows that of a transfer which is done after all: of one that is answered twice the kernel pulls the plug. */
  unlink(sequence, other) {
    const answer = (withdrawn) => {
      const reply = Buffer.alloc(HEAD);
      reply.writeUInt32BE(UNLINKED, 0);
      reply.writeUInt32BE(sequence, 4);
      reply.writeInt32BE(withdrawn ? ECONNRESET : 0, 20);
      this.send(reply);
    };
    const transfer = this.pending.get(other);
    if (transfer) bus.withdraw(transfer, answer);
    else answer(false);
  }

  answer(sequence, status, length, data) {
    const reply = Buffer.alloc(HEAD);
    reply.writeUInt32BE(SUBMITTED, 0);
    reply.writeUInt32BE(sequence, 4);
    reply.writeInt32BE(status, 20);
    reply.writeInt32BE(length, 24);
    this.send(Buffer.concat([reply, data]));
  }

  send(reply) {
    if (!this.socket.destroyed) this.socket.write(reply);
  }
}

/* ------------------------------------------------------------------ time */

let worldBegan = 0;
let boardBegan = 0;
let heard = 0; // when the host last spoke
let standsStill = true;

function pace() {
  worldBegan = performance.now();
  boardBegan = pico.now;
}

function hear() {
  heard = performance.now();
  if (!standsStill) return;
  standsStill = false;
  pace();
  live();
}

function live() {
  standsStill = performance.now() - heard > PATIENCE;
  if (standsStill) return;
  const goal = boardBegan + (performance.now() - worldBegan) * 1e6 * settings.pace;
  if (goal - pico.now > BEHIND) pace();
  if (goal <= pico.now) {
    setTimeout(live, 1);
    return;
  }
  pico.runUntil(Math.min(goal, pico.now + SLICE));
  setImmediate(live);
}

function tell() {
  strongest = Math.max(strongest, motor.most);
  const status = {
    urbs,
    now: pico.now,
    enabled: pico.enabled,
    current: motor.current,
    strongest,
    truth: pico.truth,
    resets: pico.resets,
    counts: bus.counts,
    errors: bus.errors,
    complaints: Object.fromEntries(pico.complaints),
  };
  fs.writeFileSync(settings.status + '.new', JSON.stringify(status));
  fs.renameSync(settings.status + '.new', settings.status);
}

pico.enumerate();
net
  .createServer((socket) => {
    if (peer) peer.socket.destroy();
    peer = new Peer(socket);
  })
  .listen(settings.socket, () => {
    tell();
    console.log('ready');
  });
hear(); // what was compiled meanwhile is fast when somebody really speaks
setInterval(tell, STATUS_EVERY);
process.stdin.on('end', () => process.exit(0));
process.stdin.resume();
