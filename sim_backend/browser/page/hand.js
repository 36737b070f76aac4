// The hand of a page: it follows a pointer or keys, critically damped and within the travel and the force of a person, as
// sim_backend.mechanics.driven_hand does. It has no tremor.

export class Hand {
  // `one`: the chosen wall.
  constructor(one) {
    const { rig, trial, wall, operator } = one.table.experiment;
    this.limits = one.tables.hand; // the constants of driven_hand
    this.omega = 2 * Math.PI * this.limits.FOLLOW_HZ;
    this.radius = rig.motion === "rotary" ? rig.mechanics.handle_radius : 1;
    this.tick_s = 1 / one.rates[0];
    this.side = wall.side;
    this.at = this.goal = this.led = trial.start;
    this.rate = this.press = this.pressRate = this.wantedPress = 0;
    const { BACK_M, AHEAD_M, AHEAD_N } = this.limits;
    const ahead = operator.hand_stiffness > 0 ? Math.min(AHEAD_M, AHEAD_N / operator.hand_stiffness) : AHEAD_M;
    // A scripted hand ends at `depth` inside the wall, and a driven one as far beyond that as its spring allows.
    this.ends = [trial.start - this.side * BACK_M / this.radius, one.position + this.side * (operator.depth + ahead) / this.radius].sort((a, b) => a - b);
  }

  wish({ position, press }) {
    this.goal = Math.min(Math.max(position, this.ends[0]), this.ends[1]);
    this.wantedPress = Math.min(Math.max(press ?? 0, 0), this.limits.PRESS_N);
  }

  // Intended position, velocity and press of the next ticks.
  next(ticks) {
    const script = new Float64Array(3 * ticks);
    const { REACH_M_S, BLOCK_S } = this.limits;
    const block = Math.max(1, Math.round(BLOCK_S / this.tick_s));
    for (let first = 0; first < ticks; first += block) {
      const count = Math.min(block, ticks - first);
      const most = REACH_M_S / this.radius * count * this.tick_s;
      this.led += Math.min(Math.max(this.goal - this.led, -most), most);
      let at = 0, rate = 0, press = 0, pressRate = 0;
      for (let i = 1; i <= count; i++) {
        [at, rate] = follow(this.omega, this.at - this.led, this.rate, i * this.tick_s);
        [press, pressRate] = follow(this.omega, this.press - this.wantedPress, this.pressRate, i * this.tick_s);
        script.set([at + this.led, rate, this.side * this.radius * (press + this.wantedPress)], 3 * (first + i - 1));
      }
      [this.at, this.rate, this.press, this.pressRate] = [at + this.led, rate, press + this.wantedPress, pressRate];
    }
    return script;
  }
}

// Distance to a fixed target, and its rate, after a time (s).
function follow(omega, distance, rate, time) {
  const pull = rate + omega * distance;
  const fade = Math.exp(-omega * time);
  const left = (distance + pull * time) * fade;
  return [left, pull * fade - omega * left];
}
