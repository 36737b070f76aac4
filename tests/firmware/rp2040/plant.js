'use strict';
/* One rigid body as sim_backend.mechanics.plant moves it, the same operations in the same order and so to the same bits; its matrices
 * come from there. `edges` tells when within a step the encoder's cell changes. */
const X = 0, V = 1, EFFORT = 2;
const STEP_S = 0, EFFORT_LIMIT = 2, COULOMB = 4, RESOLUTION = 6, OFFSET = 7, SIGN = 8;

const clip = (value, limit) => {
  const magnitude = Math.min(Math.abs(value), limit);
  return value < 0 || Object.is(value, -0) ? -magnitude : magnitude;
};

class Plant {
  constructor({ phi, gamma, parameters, position }) {
    this.phi = phi;
    this.gamma = gamma;
    this.parameters = parameters;
    this.state = [position, 0, 0];
    this.cell = this.cellOf(position);
  }

  get stepNanos() {
    return Math.round(this.parameters[STEP_S] * 1e9);
  }

  get sign() {
    return this.parameters[SIGN];
  }

  cellOf(position) {
    return Math.floor(position / this.parameters[RESOLUTION] + this.parameters[OFFSET]);
  }

  /* One inner step under a command (N·m); calls edge(±1 in cells, share of the step). */
  step(wanted, edge) {
    const { phi, gamma, parameters: p, state } = this;
    const command = clip(wanted, p[EFFORT_LIMIT]);
    const [x, v, effort] = state;
    const pushX = gamma[0][0] * command + gamma[0][1] * 0;
    const pushV = gamma[1][0] * command + gamma[1][1] * 0;
    const pushE = gamma[2][0] * command + gamma[2][1] * 0;
    const free = phi[1][1] * v + phi[1][2] * effort + pushV;
    let friction = free * (-1.0 / gamma[1][2]);
    let vNext = 0.0;
    if (Math.abs(friction) > p[COULOMB]) {
      friction = clip(friction, p[COULOMB]);
      vNext = free + gamma[1][2] * friction;
    }
    let xNext = x;
    if (v !== 0.0 || vNext !== 0.0) xNext += phi[0][1] * v + phi[0][2] * effort + pushX + gamma[0][2] * friction;
    state[EFFORT] = phi[2][1] * v + phi[2][2] * effort + pushE + gamma[2][2] * friction;
    state[X] = xNext;
    state[V] = vNext;
    const cell = this.cellOf(xNext);
    while (this.cell !== cell) {
      const way = cell > this.cell ? 1 : -1;
      const boundary = way > 0 ? this.cell + 1 : this.cell;
      const at = ((boundary - p[OFFSET]) * p[RESOLUTION] - x) / (xNext - x);
      this.cell += way;
      edge(way, Math.min(Math.max(at, 0), 1));
    }
  }
}

module.exports = { Plant };
