"use strict";

const AXES = [
  ["roll", "deg", 180 / Math.PI], ["pitch", "deg", 180 / Math.PI], ["yaw", "deg", 180 / Math.PI],
  ["X", "mm", 1e3], ["Y", "mm", 1e3], ["Z", "mm", 1e3],
];
const WINDOW = 12; // [s] that the traces show
const BEFORE = 1; // [s] that they show before the cause of an end
const at = (id) => document.getElementById(id);
const SILENCE = 3; // [s] without a row after which the page says so
const LOST = "No connection: the session has ended, or too many pages show it. Nothing below is live. This page goes on by itself where the session does; else start it again in the terminal.";
const SILENT = "The simulation has not answered for some seconds: it is busy, or its process is stopped.";

let about, home, last = null, held = null, traces = {}, view, heard = 0;
let told = 0; // the number of the latest command that has arrived
let sending = false;
const waiting = []; // commands in their order

/** Tells the session, one command after the other: of two requests at once the later may arrive first. */
async function tell(command) {
  // Of what a drag tells, only the last place counts.
  if (["aim", "pull", "turn", "hold", "speed"].includes(command.do) && waiting.at(-1)?.do === command.do) waiting.pop();
  waiting.push(command);
  if (sending) return;
  sending = true;
  while (waiting.length) await send(waiting.shift());
  sending = false;
}

async function send(command) {
  try {
    const answer = await fetch("do", {
      method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(command),
    });
    if (answer.ok) told = Math.max(told, (await answer.json()).number);
    else at("message").textContent = `refused: ${answer.status} ${answer.statusText}`;
  } catch {
    gone(LOST);
  }
}

/** Says that nothing here is live, and why; an empty text says that it is again. */
function gone(why) {
  at("gone").textContent = why && last?.ended ? `Ended: ${last.ended}. ${why}` : why;
  at("gone").hidden = !why;
  document.body.classList.toggle("gone", why !== "");
}

function slider(parent, name, unit, low, high, value) {
  const label = document.createElement("label");
  label.className = "slider";
  label.innerHTML = `${name} <input type="range" step="any"><output></output>`;
  const [input, output] = [label.querySelector("input"), label.querySelector("output")];
  input.min = low; input.max = high; input.value = value; input.id = `pose-${name}`;
  const write = () => { output.textContent = `${Number(input.value).toFixed(1)} ${unit}`; };
  write();
  parent.append(label);
  return { input, write };
}

/** Calls `during` while a slider is dragged and `after` once it is let go; in between it is `held`. */
function hold(input, during, after) {
  input.addEventListener("input", (event) => { held = input; during(event); });
  input.addEventListener("change", (event) => { held = null; after(event); });
  // A slider that is back where it was has not changed.
  for (const end of ["pointerup", "pointercancel"]) input.addEventListener(end, () => { held = null; });
}

function options(select, entries) {
  for (const [value, text] of entries) select.append(new Option(text, value));
}

/** A plot of the last seconds. Of one name its value stands in the title, with that of the robot beside it. */
function trace(title, unit, names) {
  const alone = names.length === 1;
  const data = [[], ...names.map(() => []), ...(alone ? [[]] : [])];
  const { box, plot } = tracePlot(at("traces"), title, unit, names, data, {
    fits: true, legend: { show: !alone }, cursor: { drag: { x: false } }, hooks: { draw: [drawCause] },
    // What happened before the end is not at the rim of the picture.
    scales: { x: { time: false, range: (_, low, high) => (last?.cause ? [last.cause.time - BEFORE, Math.max(high, last.cause.time + 0.2)] : [low, high]) } },
  });
  if (alone) plot.addSeries({ stroke: "#009e73", width: 1.5, dash: [6, 4], points: { show: false } });
  const heading = box.querySelector(".u-title");
  return {
    box,
    plot,
    data,
    add(time, values) {
      if (data[0].length && time < data[0].at(-1)) data.forEach((each) => { each.length = 0; });
      if (time === data[0].at(-1)) return;
      data[0].push(time);
      values.forEach((value, k) => data[k + 1].push(value));
      while (data[0][0] < time - WINDOW) data.forEach((each) => each.shift());
    },
    /** Another robot is beside it, or none. */
    alone() {
      data[2].fill(null);
    },
    draw() {
      plot.setData(data);
      if (!alone) return;
      const [own, beside] = [data[1].at(-1), data[2].at(-1)];
      heading.textContent = beside == null ? `${title}: ${measured(own, unit)}`
        : `${title.split(" ")[0]}: ${measured(own, unit, 2)} (pale: ${measured(beside, unit, 2)})`;
    },
  };
}

/** A line in a trace at the time of what ended the run, and one at the limit, if the trace has it. */
function drawCause(plot) {
  if (!last?.cause) return;
  const { ctx, bbox: { left, top, width, height } } = plot;
  const lines = [plot.valToPos(last.cause.time, "x", true)].map((x) => [x, top, x, top + height]);
  const limit = plot.limit?.(last.cause);
  if (limit != null) for (const level of [limit, -limit].map((value) => plot.valToPos(value, "y", true))) {
    if (level >= top && level <= top + height) lines.push([left, level, left + width, level]);
  }
  ctx.save();
  Object.assign(ctx, { strokeStyle: "#b00020", lineWidth: 2 * devicePixelRatio });
  ctx.setLineDash([]);
  for (const [x, y, toX, toY] of lines) {
    ctx.beginPath();
    ctx.moveTo(x, y);
    ctx.lineTo(toX, toY);
    ctx.stroke();
  }
  ctx.restore();
}

/** What ended the run: a text over the robot, its leg in red, or its platform. */
function showCause(cause) {
  at("cause").hidden = !cause;
  at("leg-label").hidden = !cause || cause.leg === null;
  if (!cause) return view.mark([]);
  at("cause").replaceChildren(...[`at ${cause.time.toFixed(3)} s: ${cause.reason.replaceAll("_", " ")}${cause.leg === null ? "" : ` of leg ${cause.leg}`}`,
    cause.limit?.length && `limit: safety.${cause.key} = ${cause.limit.join(", ")}${cause.unit && ` [${cause.unit}]`}`]
    .filter(Boolean).map((text) => Object.assign(document.createElement("p"), { textContent: text })));
  at("leg-label").textContent = `leg ${cause.leg}`;
  if (cause.leg === null) view.mark(["platform"]);
  else view.mark([`crank_${cause.leg}`, `rod_${cause.leg}`], at("leg-label"));
}

/** The response to a step or a sine that was asked for, from its start; a drag zooms. */
class TestPlot {
  /** Asks for the curves where the text of the test has changed, and a few times a second while it is under way. */
  show(text) {
    if (this.box) this.box.hidden = !text;
    if (this.asking || !(text !== this.text || (text.endsWith("under way") && performance.now() > this.due))) return;
    Object.assign(this, { text, asking: true, due: performance.now() + 250 });
    fetch("curves").then((answer) => answer.json()).then((curves) => this.draw(text, curves))
      .catch(() => {}).finally(() => { this.asking = false; });
  }

  draw(text, { axis, time, reference, response, beside }) {
    if (!time) return;
    const unit = axis < 3 ? "deg" : "m", scale = axis < 3 ? AXES[axis][2] : 1;
    const data = [time, ...[reference, response, beside ?? response.map(() => null)].map((values) =>
      values.map((value) => (value === null ? null : value * scale)))];
    if (this.unit !== unit) {
      this.box?.remove();
      Object.assign(this, { unit }, tracePlot(at("traces"), text, unit, ["reference", "robot", "pale"], data, {
        fits: true, kind: "test", colours: ["#1d2733", COLOURS[0], COLOURS[2]], cursor: { drag: { x: true, y: true, uni: 30 } },
      }));
      this.plot.series[1].dash = [6, 4];
    }
    this.box.querySelector(".u-title").textContent = `change of ${AXES[axis][0]}; ${text.split("; pale")[0]}`;
    this.plot.setSeries(3, { show: Boolean(beside) });
    this.plot.setData(data);
  }
}

async function begin() {
  try {
    about = await (await fetch("about")).json();
  } catch {
    return gone(LOST);
  }
  document.title = `${about.name} - stewart-drake live`;
  at("name").textContent = about.machine ? `${about.name} on ${about.machine}` : about.name;
  document.body.classList.toggle("steers", Boolean(about.machine));
  document.body.classList.toggle("instrument", Boolean(about.instrument));
  view = new RobotScene(at("robot"), about.scene);
  document.body.classList.toggle("rolls", Boolean(about.ball));
  const hand = about.ball ? new BallHand(view, about.ball, tell) : null;
  const pull = !about.instrument ? null : new Pull(view, view.links.find(({ name }) => name === "platform"), tell,
    ({ shiftKey, button }) => shiftKey || button === 2 || at("turns").checked, about.scene.links.reference[0].size[0]);
  at("on-base").hidden = !about.on_base;
  const knobs = new Knobs(tell, hold);
  home = about.home;
  const sliders = AXES.map(([name, unit, scale], k) =>
    slider(at("pose"), name, unit, (home[k] - about.room[k]) * scale, (home[k] + about.room[k]) * scale, home[k] * scale));
  const asked = () => sliders.map(({ input }, k) => Number(input.value) / AXES[k][2]);
  for (const { input, write } of sliders) {
    hold(input, () => { write(); tell({ do: "aim", pose: asked() }); }, () => {});
  }
  at("home").addEventListener("click", () => tell({ do: "aim", pose: home }));
  at("move").addEventListener("change", (event) => tell({ do: "move", on: event.target.checked }));

  at("push-force").addEventListener("input", (event) => { at("push-force-text").textContent = `${Number(Number(event.target.value).toPrecision(2))} N`; });
  for (const [axis, name] of [[3, "X"], [4, "Y"], [5, "Z"]]) for (const sign of [1, -1]) {
    const button = document.createElement("button");
    button.textContent = `${sign > 0 ? "+" : "−"}${name}`;
    button.id = `push-${sign > 0 ? "plus" : "minus"}-${name}`;
    button.addEventListener("click", () => {
      const wrench = [0, 0, 0, 0, 0, 0];
      wrench[axis] = sign * Number(at("push-force").value);
      tell({ do: "push", wrench, duration: 0.1 });
    });
    at("pushes").append(button);
  }
  at("payload").max = about.payload_most;
  at("payload").step = about.payload_most / 20;
  const legs = [["", "none"], ...[0, 1, 2, 3, 4, 5].map((leg) => [leg, `leg ${leg}`])];
  const legOf = ({ target }) => (target.value === "" ? null : Number(target.value));
  options(at("dead"), legs);
  options(at("frozen"), legs);
  options(at("controller"), about.controllers.map((name) => [name, name]));
  options(at("ghost"), [["", "none"], ...about.controllers.map((name) => [name, name])]);
  options(at("test-axis"), AXES.map(([name]) => [name, name]));
  at("test-axis").value = "Z";
  const testAxis = () => AXES.find(([name]) => name === at("test-axis").value);
  const writeTest = () => {
    const [name, unit, scale] = testAxis();
    at("test-unit").textContent = unit;
    at("test-size").value = about.test_sizes && Number((about.test_sizes[AXES.findIndex(([each]) => each === name)] * scale).toPrecision(1));
  };
  at("test-axis").addEventListener("change", writeTest);
  writeTest();
  const off = (id, why) => {
    at(id).disabled = true;
    at(`${id}-label`).classList.add("off");
    at(`${id}-label`).title = why;
  };
  if (!about.encoders) off("frozen", "this scenario reads poses: --set sensors=encoders");
  if (!about.may_fail) off("dead", "these motors take no torque: none of them can be off alone");
  for (const id of ["push-force"]) {
    at(id).max = about.force_most ?? 20;
    at(id).min = at(id).step = at(id).max / 40;
    at(id).value = at(id).max / 4;
    at("push-force-text").textContent = `${Number(Number(at(id).value).toPrecision(2))} N`;
  }
  const writePayload = () => { at("payload-text").textContent = `${Number(at("payload").value).toPrecision(2)} kg`; };
  const writeKappa = () => { at("kappa-text").textContent = Number(at("kappa").value).toFixed(1); };
  hold(at("payload"), writePayload, (event) => tell({ do: "payload", mass: Number(event.target.value) }));
  hold(at("kappa"), writeKappa, (event) => tell({ do: "kappa", value: Number(event.target.value) }));
  at("dead").addEventListener("change", (event) => tell({ do: "dead", leg: legOf(event) }));
  at("frozen").addEventListener("change", (event) => tell({ do: "freeze", leg: legOf(event) }));
  at("controller").addEventListener("change", (event) => tell({ do: "controller", name: event.target.value }));
  at("pause").addEventListener("click", () => tell({ do: "pause", on: !(last && last.paused) }));
  // At once, and nothing that waits after it.
  at("stop").addEventListener("click", () => {
    waiting.length = 0;
    send({ do: "stop" });
  });
  at("tick").addEventListener("click", () => tell({ do: "step" }));
  at("save").addEventListener("click", () => tell({ do: "save" }));
  at("speed").addEventListener("input", ({ target }) => tell({ do: "speed", value: Number(target.value) }));
  at("ghost").addEventListener("change", ({ target }) => tell({ do: "ghost", controller: target.value || null }));
  at("test-frequency").addEventListener("change", ({ target }) => {
    target.value = Math.min(target.max, Math.max(target.min, Number(target.value) || 1));
  });
  for (const kind of ["step", "sine"]) at(`test-${kind}`).addEventListener("click", () =>
    tell({ do: "test", kind, axis: at("test-axis").value, size: Number(at("test-size").value) / testAxis()[2], frequency: Number(at("test-frequency").value) }));
  at("reset").addEventListener("click", () => tell({ do: "reset" }));
  at("help-open").addEventListener("click", () => at("help").showModal());
  const arrows = { ArrowLeft: [3, -1], ArrowRight: [3, 1], ArrowDown: [4, -1], ArrowUp: [4, 1] };
  document.addEventListener("keydown", (event) => {
    const { target, key, shiftKey } = event, on = (kinds) => target.matches(kinds);
    if (event.ctrlKey || event.altKey || event.metaKey || at("help").open || on("select, [type=number]")) return;
    if (key === " " && (about.machine || !on("button, [type=checkbox]"))) at(about.machine ? "stop" : "pause").click();
    else if (key.toLowerCase() === "r" && !about.machine) at("reset").click();
    else if (arrows[key] && !on("input")) {
      const [axis, way] = arrows[key], { input, write } = sliders[axis + (shiftKey && axis === 4)];
      input.value = Number(input.value) + way * (input.max - input.min) / 40;
      write();
      tell({ do: "aim", pose: asked() });
    } else return;
    event.preventDefault();
  });
  // Space is for the whole page after a click on a button, too.
  document.addEventListener("click", ({ target, detail }) => { if (detail && target.matches("button")) target.blur(); });
  new ResizeObserver(() => document.documentElement.style.setProperty("--top", `${at("top").offsetHeight + 10}px`)).observe(at("top"));

  traces = {
    ...(about.ball && { ball: trace("ball off target", "m", ["ball"]) }),
    error: trace("position error", "m", ["position"]),
    angle: trace("rotation error", "deg", ["rotation"]),
    torque: trace("torque", "N m", ["leg 0", "1", "2", "3", "4", "5"]),
    setting: trace("tuner's setting", "decades", ["speed", "damping", "integral", "disturbance"]),
  };

  /** Everything that can be set, as the session has it, whoever has set it. */
  const write = (row) => {
    const values = { payload: row.payload, kappa: row.kappa, dead: row.dead ?? "", frozen: row.frozen ?? "", controller: row.controller };
    for (const [id, value] of Object.entries(values)) if (at(id) !== held) at(id).value = value;
    at("move").checked = row.motion;
    if (about.instrument) {
      knobs.show(row.knobs, held);
      at("ghost").value = row.ghost;
      at("speed").value = row.speed;
      at("speed-text").textContent = `× ${row.speed}`;
    }
    writePayload();
    writeKappa();
    sliders.forEach(({ input, write: text }, k) => {
      if (sliders.some((each) => each.input === held)) return;
      input.value = row.target[k] * AXES[k][2];
      text();
    });
  };

  traces.angle.plot.limit = ({ key, limit }) => (key === "following_error" ? limit[0] * 180 / Math.PI : null);
  traces.error.plot.limit = ({ key, limit }) => (key === "following_error" ? limit[1] : null);
  traces.torque.plot.limit = ({ key, limit, leg }) => (key === "torque_limit" && leg !== null ? limit[0] * about.effort_limits[leg] : null);
  const test = new TestPlot();
  let stale = true, ghost, events, caused = null;
  const listen = () => {
    events = new EventSource("events");
    events.onmessage = show;
    events.onerror = () => {
      gone(LOST);
      // A browser does not come back by itself to a session with too many pages.
      if (events.readyState === EventSource.CLOSED) setTimeout(listen, 1000 * SILENCE);
    };
  };
  const show = ({ data }) => {
    last = JSON.parse(data);
    // Another session at this address has another robot.
    if (last.session !== about.session) location.reload();
    heard = performance.now();
    gone("");
    at("clock").textContent = `${last.time.toFixed(last.paused ? 3 : 1)} s`;
    at("factor").textContent = last.paused ? "paused" : `× ${last.factor.toFixed(2)}`;
    at("pause").textContent = last.paused ? "Run" : "Pause";
    at("message").textContent = last.ended ? `ended: ${last.ended}${about.machine ? "" : " (Reset begins anew)"}` : last.message;
    at("message").className = last.ended ? "ended" : "";
    // Not before what was asked for here is done: the control would jump back for a moment.
    if (!sending && last.obeyed >= told) write(last);
    if (about.instrument) {
      pull.show(last);
      at("test-result").textContent = last.test.replace(/^[^:]*: /, "");
      test.show(last.test);
      at("message").textContent = [
        last.pull && `pulled with ${measured(last.pull.force, "N", 2)}`,
        last.moment && `turned with ${measured(Math.hypot(...last.moment), "N m", 2)}`,
        at("message").textContent,
        !last.ended && last.hand,
        last.beside?.ended && `pale: ended: ${last.beside.ended}`,
      ].filter(Boolean).join("; ");
    }
    const cause = last.cause ?? null;
    if (JSON.stringify(cause) !== JSON.stringify(caused)) showCause(caused = cause);
    if (last.links) {
      view.place(last.links);
      if (last.ghost !== ghost) for (const each of [traces.error, traces.angle, traces.ball]) each?.alone();
      ghost = last.ghost;
      traces.error.add(last.time, [last.position_m, last.beside?.position_m ?? null]);
      traces.angle.add(last.time, [last.rotation_deg, last.beside?.rotation_deg ?? null]);
    }
    if (hand) {
      hand.show(last);
      traces.ball.add(last.time, [last.ball?.away_m ?? null, last.beside?.away_m ?? null]);
    }
    // Servos tell no torque.
    traces.torque.box.hidden = !last.torque;
    if (last.torque) traces.torque.add(last.time, last.torque);
    // Not every controller has a tuner.
    at("kappa-label").hidden = last.kappa === null || !last.setting;
    traces.setting.box.hidden = !last.setting;
    if (last.setting) traces.setting.add(last.time, last.setting.slice(0, 4));
    stale = true;
  };
  listen();
  setInterval(() => {
    if (events.readyState === EventSource.OPEN && performance.now() - heard > 1000 * SILENCE) gone(SILENT);
  }, 500);
  const draw = () => {
    if (stale) Object.values(traces).forEach((each) => each.draw());
    stale = false;
    requestAnimationFrame(draw);
  };
  draw();
}

begin();
