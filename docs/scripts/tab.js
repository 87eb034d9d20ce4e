"use strict";

/* Stands in for the server of the live page: the robot, its motors, its sensors and its controller run in this tab, as
   WebAssembly. What the page asks with fetch and EventSource is answered here; see docs/scripts/tab.py. */

/** A value that follows a target through three equal poles: `live.steering.SmoothValue`. */
class SmoothValue {
  constructor(value, transitions) {
    this.transitions = transitions;
    this.target = [...value];
    this.state = [[...value], value.map(() => 0), value.map(() => 0)];
  }

  /** Value, rate and acceleration after a step, or after those that the controller looks ahead. */
  after(ahead) {
    const matrix = this.transitions[ahead ? 1 : 0];
    const away = [this.state[0].map((value, k) => value - this.target[k]), this.state[1], this.state[2]];
    return matrix.map((row, i) => this.target.map((target, k) =>
      (i === 0 ? target : 0) + (row[0] * away[0][k] + row[1] * away[1][k] + row[2] * away[2][k])));
  }

  advance() { this.state = this.after(false); }
}

/** A robot of the page with the controller that is chosen; it takes commands and gives rows as `live.session` does. */
class TabSession {
  constructor(robot) {
    this.robot = robot;
    this.obeyed = 0;
    this.paused = false;
    this.message = "";
  }

  /** Compiles the modules of the robot, which takes a moment. */
  async load() {
    this.modules = {};
    for (const [name, { code }] of Object.entries(this.robot.modules)) {
      const bytes = Uint8Array.from(atob(code), (letter) => letter.charCodeAt(0));
      const env = { ...Object.fromEntries(["sin", "cos", "asin", "acos", "atan2", "tanh", "exp", "log10", "pow"]
        .map((law) => [law, Math[law]])), fmod: (a, b) => a % b };
      this.modules[name] = (await WebAssembly.instantiate(bytes, { env })).instance.exports;
    }
    this.reset();
  }

  reset() {
    const { motion, transitions, about, friction_now } = this.robot;
    this.hand = new SmoothValue(about.home, transitions);
    this.share = new SmoothValue([1], transitions);
    this.home = this.moved(0)[0];
    this.settings = { payload: 0, dead: null, kappa: 0, friction: friction_now, learns: false };
    this.wrench = [0, 0, 0, 0, 0, 0];
    this.pushEnds = -1;
    this.ended = "";
    this.cause = null;
    this.controller = null;
    this.choose(about.controllers[0]);
  }

  // --- the loop ---

  /** A part of the module's memory: the double at which it begins, and how many. */
  doubles([start, size], module = this.module) {
    return new Float64Array(module.memory.buffer, module.tab_memory() + 8 * start, size);
  }

  place(name) { return this.robot.modules[this.controller].places[name]; }

  /** Another controller on the same robot; each part that both have goes on from where it is. */
  choose(name) {
    const before = this.controller === null ? null : { module: this.module, ...this.robot.modules[this.controller] };
    this.controller = name;
    this.module = this.modules[name];
    this.module.tab_begin();
    this.own = Array.from(this.place("motors_limit") ? this.doubles(this.place("motors_limit")) : []);
    const { places, kinds } = this.robot.modules[name];
    if (before) {
      const shared = Object.keys(kinds).filter((part) => before.kinds[part] === kinds[part]);
      for (const part of ["steps", "measured", ...shared]) {
        this.doubles(places[part]).set(this.doubles(before.places[part], before.module));
      }
    }
    this.write();
  }

  /** Writes what the panel has set into the constants of plant, motors and laws. */
  write() {
    const { fixed, payload, friction, friction_now } = this.robot;
    const { settings } = this;
    const numbers = fixed.map((value, k) => value + settings.payload * payload[k] + (settings.friction - friction_now) * friction[k]);
    const [robot, dry] = [this.doubles(this.place("plant_robot")), this.doubles(this.place("plant_friction"))];
    robot.set(numbers.slice(0, robot.length));
    dry.set(numbers.slice(robot.length));
    const limit = this.doubles(this.place("motors_limit"));
    this.own.forEach((most, leg) => { limit[leg] = leg === settings.dead ? 0 : most; });
    this.doubles(this.place("learner_params"))[0] = settings.learns ? this.robot.learning : 0;
    if (this.place("tuner_params")) this.doubles(this.place("tuner_params"))[this.robot.kappa] = settings.kappa;
  }

  /** Pose, rate and acceleration of the scenario's motion, (3, 6), at a time [s]. */
  moved(time) {
    const { center, amplitude, angular_frequency: omega, phase } = this.robot.motion;
    const angle = omega.map((each, k) => each * time + phase[k]);
    const wave = amplitude.map((each, k) => each * Math.sin(angle[k]));
    return [wave.map((each, k) => center[k] + each), wave.map((_, k) => amplitude[k] * omega[k] * Math.cos(angle[k])),
      wave.map((each, k) => -omega[k] * omega[k] * each)];
  }

  /** `live.steering.HandReference.at`: (18,). */
  wanted(time, ahead) {
    const hand = ahead ? this.hand.after(true) : this.hand.state;
    const [[s], [rate], [acceleration]] = ahead ? this.share.after(true) : this.share.state;
    const [pose, velocity, force] = this.moved(time + (ahead ? this.robot.ahead * this.robot.step : 0));
    const own = pose.map((value, k) => value - this.home[k]);
    return [...own.map((each, k) => hand[0][k] + s * each),
      ...own.map((each, k) => hand[1][k] + rate * each + s * velocity[k]),
      ...own.map((each, k) => hand[2][k] + acceleration * each + 2 * rate * velocity[k] + s * force[k])];
  }

  get steps() { return this.doubles(this.place("steps"))[0]; }

  get time() { return this.steps * this.robot.step; }

  /** Some steps of the plant. */
  advance(count) {
    const [reference, wrench] = [this.doubles(this.place("reference")), this.doubles(this.place("wrench"))];
    const ahead = this.place("reference_ahead") ? this.doubles(this.place("reference_ahead")) : null;
    for (let k = 0; k < count && !this.ended; k += 1) {
      const [time, pushed] = [this.time, this.steps < this.pushEnds];
      reference.set(this.wanted(time, false));
      if (ahead) ahead.set(this.wanted(time, true));
      this.wrench.forEach((value, axis) => { wrench[axis] = pushed ? value : 0; });
      const status = this.module.tab_step();
      this.hand.advance();
      this.share.advance();
      if (status !== 0) this.end(status);
    }
  }

  end(status) {
    const { parts, safety } = this.robot.modules[this.controller];
    this.ended = `${parts[status - 1]} failed`;
    this.cause = { reason: this.ended, time: this.time, leg: null };
    if (parts[status - 1] === "safety") {
      const [, monitor, leg] = this.doubles(safety);
      this.ended = `safety: ${this.robot.monitors[monitor].replaceAll("_", " ")}${leg >= 0 ? `, leg ${leg}` : ""}`;
      Object.assign(this.cause, { reason: this.robot.monitors[monitor], leg: leg >= 0 ? leg : null });
    }
  }

  // --- what the page asks for ---

  tell(command) {
    this.obeyed += 1;
    this.message = "";
    const set = (name, value) => { this.settings[name] = value; this.write(); };
    const does = {
      aim: () => this.aim(command.pose),
      move: () => { this.share.target[0] = command.on ? 1 : 0; },
      push: () => { this.wrench = command.wrench; this.pushEnds = this.steps + Math.round(command.duration / this.robot.step); },
      payload: () => set("payload", command.mass),
      dead: () => set("dead", command.leg),
      kappa: () => set("kappa", command.value),
      friction: () => set("friction", command.value),
      learn: () => set("learns", command.on),
      controller: () => this.choose(command.name),
      pause: () => { this.paused = command.on; },
      reset: () => this.reset(),
    };
    does[command.do]();
    return this.obeyed;
  }

  /** Sends the hand to a pose, or as far towards it as the robot can go. */
  aim(pose) {
    const here = this.hand.state[0], asked = this.doubles(this.place("asked"));
    // What the motion adds to the pose, over its slowest period.
    const period = 2 * Math.PI / Math.min(...this.robot.motion.angular_frequency);
    const around = Array.from({ length: this.share.target[0] > 0 ? 24 : 1 }, (_, n) =>
      this.moved(n * period / 24)[0].map((value, k) => (this.share.target[0] > 0 ? value - this.home[k] : 0)));
    const reaches = (share) => around.every((own) => {
      asked.set(here.map((value, k) => value + share * (pose[k] - value) + own[k]));
      return this.module.tab_allowed() !== 0;
    });
    let low = 0, high = 1;
    for (let round = 0; round < 4; round += 1) {
      const shares = Array.from({ length: 24 }, (_, k) => low + (high - low) * (k + 1) / 24);
      const broken = shares.findIndex((share) => !reaches(share));
      if (broken < 0) { low = high; break; }
      [low, high] = [broken > 0 ? shares[broken - 1] : low, shares[broken]];
    }
    if (low < 1) this.message = "as far as it goes";
    this.hand.target = here.map((value, k) => value + low * (pose[k] - value));
  }

  row() {
    const [measured, frames] = [this.doubles(this.place("measured")), this.doubles(this.place("scene"))];
    const { settings } = this, wanted = this.wanted(this.time, false);
    const pose = Array.from(measured.slice(0, 6)), error = pose.map((value, k) => value - wanted[k]);
    const { setting, torque, safety } = this.robot.modules[this.controller];
    return {
      session: "tab", obeyed: this.obeyed, time: this.time, factor: this.paused ? 0 : this.factor ?? 1,
      rotation_deg: Math.hypot(...error.slice(0, 3)) * 180 / Math.PI, position_m: Math.hypot(...error.slice(3)),
      torque: Array.from(this.doubles(torque)), setting: setting && Array.from(this.doubles(setting)),
      safety: this.doubles(safety)[0], target: this.hand.target, pose, frames: Array.from(frames),
      pushed: this.steps < this.pushEnds, motion: this.share.target[0] > 0, payload: settings.payload,
      dead: settings.dead, frozen: null, controller: this.controller, kappa: setting ? settings.kappa : null,
      paused: this.paused, ended: this.ended, cause: this.cause, message: this.message,
    };
  }
}

/** Position and quaternion x, y, z, w of each link, from its three axes and its place. */
function linksOf(frames) {
  const links = [];
  for (let k = 0; k < frames.length; k += 12) {
    const entry = (row, column) => frames[k + 3 * column + row];
    // From the largest of the four, so that no digits are lost.
    const squares = [[1, -1, -1], [-1, 1, -1], [-1, -1, 1], [1, 1, 1]]
      .map((signs) => 1 + signs.reduce((sum, sign, n) => sum + sign * entry(n, n), 0));
    const best = squares.indexOf(Math.max(...squares)), turn = [0, 0, 0, 0];
    const size = 2 * Math.sqrt(squares[best]), [n, m] = [(best + 1) % 3, (best + 2) % 3];
    turn[best] = size / 4;
    if (best === 3) {
      for (let i = 0; i < 3; i += 1) turn[i] = (entry((i + 2) % 3, (i + 1) % 3) - entry((i + 1) % 3, (i + 2) % 3)) / size;
    } else {
      turn[n] = (entry(best, n) + entry(n, best)) / size;
      turn[m] = (entry(best, m) + entry(m, best)) / size;
      turn[3] = (entry(m, n) - entry(n, m)) / size;
    }
    links.push(...frames.slice(k + 9, k + 12), ...turn);
  }
  return links;
}

if (typeof document !== "undefined") {
  const SLICE = 20; // [ms]
  const MOST = 5; // slices that the robot may be behind the clock
  const robots = JSON.parse(document.getElementById("tab-data").textContent);
  const names = Object.keys(robots);
  const name = names.find((each) => decodeURIComponent(location.hash.slice(1)) === each) ?? names[0];
  const session = new TabSession(robots[name]);
  const pages = [];

  // What the page of `live` does not have: another robot, friction that nobody told the controller, and learning it.
  const chosen = document.createElement("select");
  chosen.id = "robot-name";
  chosen.ariaLabel = "robot";
  for (const each of names) chosen.append(new Option(each, each, each === name, each === name));
  chosen.addEventListener("change", () => { location.hash = encodeURIComponent(chosen.value); location.reload(); });
  const heading = document.getElementById("name");
  heading.after(chosen);
  heading.hidden = true;
  const [least, most] = session.robot.friction_ends;
  const more = document.createElement("div");
  more.innerHTML = `<label class="slider">dry friction <input type="range" id="friction" min="${least}" max="${most}" step="any" value="${session.robot.friction_now}"><output id="friction-text"></output></label>
    <label><input type="checkbox" id="learn"> the controller learns it</label>`;
  document.getElementById("payload").closest("fieldset").append(more);
  const [slider, text] = [document.getElementById("friction"), document.getElementById("friction-text")];
  const write = () => { text.textContent = `${Number(slider.value).toFixed(3)} N m`; };
  slider.addEventListener("input", () => { write(); session.tell({ do: "friction", value: Number(slider.value) }); });
  document.getElementById("learn").addEventListener("change", (event) => session.tell({ do: "learn", on: event.target.checked }));
  document.getElementById("reset").addEventListener("click", () => {
    slider.value = session.robot.friction_now;
    document.getElementById("learn").checked = false;
    write();
  });
  write();

  window.fetch = async (address, asked) => {
    const answer = (content) => new Response(JSON.stringify(content), { headers: { "Content-Type": "application/json" } });
    if (address === "do") return answer({ number: session.tell(JSON.parse(asked.body)) });
    await session.load();
    let due = performance.now(), window_ = { at: due, time: 0 };
    setInterval(() => {
      const now = performance.now();
      // A tab that was in the background does not catch up.
      if (now - due > MOST * SLICE) due = now - SLICE;
      for (; due < now; due += SLICE) if (!session.paused) session.advance(session.robot.stride);
      if (now - window_.at > 1000) {
        session.factor = Math.max(0, session.time - window_.time) / (now - window_.at) * 1000;
        window_ = { at: now, time: session.time };
      }
      const row = session.row();
      const event = { data: JSON.stringify({ ...row, links: linksOf(row.frames), frames: undefined }) };
      for (const page of pages) if (page.onmessage) page.onmessage(event);
    }, SLICE);
    return answer({ ...session.robot.about, session: "tab" });
  };
  window.EventSource = class {
    constructor() {
      this.readyState = 1;
      pages.push(this);
    }
  };
  window.EventSource.OPEN = 1;
  window.EventSource.CLOSED = 2;
}

if (typeof module !== "undefined") module.exports = { TabSession, linksOf };
