'use strict';
/* The board at the end of a pipe: one command a line in, one answer a line out, both JSON. */
const fs = require('node:fs');
const readline = require('node:readline');
const { UsbPico: Pico } = require('./usb_pico.js');
const { Motor } = require('./motor.js');
const { Plant } = require('./plant.js');

let pico = null;
let motor = null;

const movesUntil = () => (pico.edges.length > 0 ? pico.edges[pico.edges.length - 1].at : pico.now);

const commands = {
  power({ image, pins, motor: description, ...how }) {
    pico = new Pico(fs.readFileSync(image), pins, how);
    pico.motor = motor = new Motor(pico, description);
    return {};
  },
  send({ hex }) {
    pico.uart.feed(Buffer.from(hex, 'hex'));
    return {};
  },
  run({ us }) {
    pico.runUntil(pico.now + us * 1000);
    const sent = Buffer.from(pico.uart.sent).toString('hex');
    pico.uart.sent.length = 0;
    return { sent };
  },
  /* Move the encoder: pairs of counts (signed) and nanoseconds between them. */
  move({ motion }) {
    let at = movesUntil();
    for (const [counts, nanos] of motion)
      for (let i = 0; i < Math.abs(counts); i++) {
        at += nanos;
        pico.edges.push({ at, way: Math.sign(counts) });
      }
    return { ends: at };
  },
  /* Both channels at once, a microsecond behind whatever is to come. */
  jump() {
    pico.edges.push({ at: movesUntil() + 1000, way: 2 });
    return {};
  },
  /* Wire sync outputs tick and trial to channels A and B, inside to the sync input, until the next reset. */
  loop() {
    const { sync_out: out, encoder, sync_in: input } = pico.pins;
    const ends = [encoder, encoder + 1, input];
    const show = () => {
      ends.forEach((end, i) => pico.setPin(end, pico.level(out + i)));
      pico.wake();
    };
    ends.forEach((_, i) => pico.chip.gpio[out + i].addListener(show));
    show();
    return {};
  },
  /* Break wires of the encoder, or pull its plug. */
  wires({ unplugged = false, broken = [false, false] }) {
    Object.assign(pico, { unplugged, broken });
    pico.showEncoder();
    return {};
  },
  /* Where index and limit switch are. */
  marks(marks) {
    Object.assign(pico.marks, marks);
    pico.showMarks();
    return {};
  },
  set(switches) {
    Object.assign(pico.switches, switches);
    pico.showSwitches();
    return {};
  },
  /* The processor stands still, as a crash would leave it: at a branch to itself, interrupts masked; or the main loop does,
   * and interrupts come. */
  hang({ interrupts = false }) {
    const { core } = pico.chip;
    while (interrupts && (core.IPSR !== 0 || core.PM)) pico.step();
    pico.chip.sramView.setUint16(0x41000, 0xe7fe, true);
    core.PM = !interrupts;
    core.PC = 0x20041000;
    core.IPSR = 0;
    return {};
  },
  /* An instruction of the main program cannot be executed: HardFault. Returns where that was. */
  crash() {
    const { core } = pico.chip;
    while (core.IPSR !== 0) pico.step();
    const at = core.PC;
    core.exceptionEntry(3);
    return { at };
  },
  /* The machine that feeds the converter does not go on, from now or from the middle of its next frame. */
  stall({ amid = false }) {
    while (amid && pico.converter.bits !== 12) pico.runUntil(pico.now + 1);
    pico.hangOutput();
    return {};
  },
  /* Close or open the contact in the wire to the converter's RESET. */
  contact({ closed }) {
    pico.contact = closed;
    pico.showReset();
    return {};
  },
  /* Frames to the converter since the last question. */
  frames() {
    return { frames: pico.converter.frames.splice(0) };
  },
  /* Time (ns) until the amplifier is off, at most so long. */
  off({ us }) {
    const begins = pico.now;
    while (pico.enabled && pico.now < begins + us * 1000) pico.runUntil(pico.now + 1);
    return { took: pico.now - begins };
  },
  look() {
    const most = motor.most;
    motor.most = 0;
    const held = pico.longestHeld;
    pico.longestHeld = 0;
    return {
      held,
      now: pico.now,
      truth: pico.truth,
      enabled: pico.enabled,
      share: pico.share,
      volts: pico.converter.volts,
      current: motor.current,
      most,
      resets: pico.resets,
      overruns: pico.uart.overruns,
      baud: pico.uart.divider ? pico.uart.baud : 0,
      position: motor.plant ? motor.plant.state[0] : 0,
      state: motor.plant ? motor.plant.state : [],
      complaints: Object.fromEntries(pico.complaints),
      vtor: pico.chip.core.VTOR,
      clock: pico.chip.clkSys,
      regulator: pico.regulator.value,
      settled: pico.settled,
      crystal_delay: pico.chip.peripherals[0x40024].startup,
      bootloader: pico.inBootloader,
    };
  },
  /* Every tick since the last question. */
  ticks() {
    const ticks = pico.takeTicks();
    const column = (name) => ticks.map((tick) => tick[name]);
    const answer = {};
    for (const name of ['came', 'at', 'ends', 'entered', 'left', 'before', 'after']) answer[name] = column(name);
    return answer;
  },
  /* Time that a pin is high (ns) over the next stretch of time. */
  high({ pin, us }) {
    const begins = pico.now;
    let high = 0;
    let since = pico.level(pin) ? begins : null;
    const stop = pico.chip.gpio[pin].addListener(() => {
      const level = pico.level(pin);
      const at = pico.born + pico.chip.clock.nanos;
      if (level && since === null) since = at;
      if (!level && since !== null) {
        high += at - since;
        since = null;
      }
    });
    pico.runUntil(begins + us * 1000);
    stop();
    if (since !== null) high += pico.now - since;
    return { high, time: pico.now - begins };
  },
  /* Cycles by instruction over the next stretch of time, in the tick's interrupt: of all, and of the longest. */
  profile({ us }) {
    const all = new Map();
    let one = new Map();
    let longest = new Map();
    const sum = (spent) => [...spent.values()].reduce((a, b) => a + b, 0);
    const ends = pico.now + us * 1000;
    let count = 0;
    while (pico.now < ends) {
      motor.upTo(pico.now);
      const { core } = pico.chip;
      const at = core.PC & ~1;
      const { cycles } = pico;
      const inside = core.IPSR === 20;
      pico.step();
      if (!inside) continue;
      one.set(at, (one.get(at) || 0) + pico.cycles - cycles);
      if (core.IPSR === 20) continue;
      for (const [pc, spent] of one) all.set(pc, (all.get(pc) || 0) + spent);
      if (sum(one) > sum(longest)) longest = one;
      one = new Map();
      count++;
    }
    return { count, all: [...all], longest: [...longest] };
  },
  /* The plant alone, for comparison: a command for each step. */
  plant({ plant, commands: efforts }) {
    const alone = new Plant(plant);
    const states = [];
    for (const effort of efforts) {
      alone.step(effort, () => {});
      states.push([...alone.state]);
    }
    return { states };
  },
};

Object.assign(commands, require('./usb_commands.js')(() => pico));

const lines = readline.createInterface({ input: process.stdin, terminal: false });
lines.on('line', (line) => {
  let answer;
  try {
    const command = JSON.parse(line);
    answer = commands[command.op](command);
  } catch (error) {
    answer = { error: error.stack };
  }
  process.stdout.write(JSON.stringify(answer) + '\n');
});
