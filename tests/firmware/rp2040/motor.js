'use strict';
const { Plant } = require('./plant.js');

const ADC_STEPS_A_VOLT = 4096 / 3.3;
const MONITOR_ZERO = 1.65;

/* The motor: the current that the pins ask for, the rig that it moves, the monitor that shows it. */
class Motor {
  constructor(pico, { plant, full_scale: fullScale, effort_per_ampere: effortPerAmpere, monitor_scale: monitorScale }) {
    this.plant = plant ? new Plant(plant) : null;
    this.fullScale = fullScale;
    this.effortPerAmpere = effortPerAmpere;
    this.monitorScale = monitorScale;
    this.pico = pico;
    this.current = 0;
    this.most = 0; // A, since last asked
    this.next = pico.now;
  }

  upTo(now) {
    const { pico } = this;
    while (now >= this.next) {
      this.current = pico.enabled ? pico.share * this.fullScale : 0;
      this.most = Math.max(this.most, Math.abs(this.current));
      let flows = this.current;
      if (this.plant) {
        const at = this.next;
        const step = this.plant.stepNanos;
        this.plant.step(this.current * this.effortPerAmpere, (way, share) =>
          pico.edges.push({ at: at + share * step, way: way * this.plant.sign }),
        );
        flows = this.plant.state[2] / this.effortPerAmpere;
        this.next += step;
      } else {
        this.next += 10000;
      }
      pico.chip.adc.channelValues[0] = Math.round((MONITOR_ZERO + flows * this.monitorScale) * ADC_STEPS_A_VOLT);
    }
  }
}

module.exports = { Motor };
