"use strict";

const AXES = [
  ["roll", "deg", 180 / Math.PI], ["pitch", "deg", 180 / Math.PI], ["yaw", "deg", 180 / Math.PI],
  ["X", "mm", 1e3], ["Y", "mm", 1e3], ["Z", "mm", 1e3],
];
const COLOURS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00"];
const WINDOW = 12; // [s] that the traces show
const at = (id) => document.getElementById(id);
const tell = (command) => fetch("do", {
  method: "POST", headers: { "Content-Type": "application/json" }, body: JSON.stringify(command),
});

let about, home, last = null, held = false, traces = {};

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

function options(select, entries) {
  for (const [value, text] of entries) select.append(new Option(text, value));
}

function trace(title, unit, names) {
  const box = document.createElement("div");
  box.className = "trace";
  at("traces").append(box);
  const data = [[], ...names.map(() => [])];
  const plot = new uPlot({
    title, width: box.clientWidth - 12, height: 190, legend: { show: names.length > 1 }, cursor: { drag: { x: false } },
    scales: { x: { time: false } },
    axes: [{ label: "time [s]", labelSize: 18, size: 34 }, { label: `[${unit}]`, labelSize: 18, size: 52 }],
    series: [{ label: "t" }, ...names.map((label, k) => ({ label, stroke: COLOURS[k], width: 1.5, points: { show: false } }))],
  }, data, box);
  new ResizeObserver(() => plot.setSize({ width: box.clientWidth - 12, height: 190 })).observe(box);
  return {
    box,
    data,
    add(time, values) {
      if (data[0].length && time < data[0].at(-1)) data.forEach((each) => { each.length = 0; });
      data[0].push(time);
      values.forEach((value, k) => data[k + 1].push(value));
      while (data[0][0] < time - WINDOW) data.forEach((each) => each.shift());
    },
    draw() { plot.setData(data); },
  };
}

async function begin() {
  about = await (await fetch("about")).json();
  document.title = `${about.name} - stewart-drake live`;
  at("name").textContent = about.name;
  at("robot").src = about.meshcat;
  home = about.home;
  const sliders = AXES.map(([name, unit, scale], k) =>
    slider(at("pose"), name, unit, (home[k] - about.room[k]) * scale, (home[k] + about.room[k]) * scale, home[k] * scale));
  const asked = () => sliders.map(({ input }, k) => Number(input.value) / AXES[k][2]);
  for (const { input, write } of sliders) {
    input.addEventListener("input", () => { held = true; write(); tell({ do: "aim", pose: asked() }); });
    input.addEventListener("change", () => { held = false; });
  }
  at("home").addEventListener("click", () => tell({ do: "aim", pose: home }));
  at("move").addEventListener("change", (event) => tell({ do: "move", on: event.target.checked }));

  at("push-force").addEventListener("input", (event) => { at("push-force-text").textContent = `${event.target.value} N`; });
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
  const change = (keys) => tell({ do: "change", keys });
  at("payload").max = about.payload_most;
  at("payload").step = about.payload_most / 20;
  const writePayload = () => { at("payload-text").textContent = `${Number(at("payload").value).toPrecision(2)} kg`; };
  at("payload").value = about.payload;
  writePayload();
  at("payload").addEventListener("input", writePayload);
  at("payload").addEventListener("change", (event) => change({ "plant.payload_mass": Number(event.target.value) }));
  const legs = [["", "none"], ...[0, 1, 2, 3, 4, 5].map((leg) => [leg, `leg ${leg}`])];
  options(at("dead"), legs);
  options(at("frozen"), legs);
  at("dead").addEventListener("change", (event) =>
    change({ "motors.dead": event.target.value === "" ? null : { leg: Number(event.target.value) } }));
  at("frozen").addEventListener("change", (event) =>
    change({ "sensors.faults": event.target.value === "" ? [] : [{ kind: "freeze", leg: Number(event.target.value) }] }));
  at("frozen-label").hidden = !about.encoders;
  options(at("controller"), about.controllers.map((name) => [name, name]));
  const writeKappa = () => { at("kappa-text").textContent = Number(at("kappa").value).toFixed(1); };
  const ownKappa = () => { at("kappa").value = about.kappa; writeKappa(); };
  ownKappa();
  at("controller").addEventListener("change", (event) => {
    tell({ do: "controller", name: event.target.value });
    ownKappa();
  });
  at("kappa").addEventListener("input", writeKappa);
  at("kappa").addEventListener("change", (event) => change({ "tuner.kappa": Number(event.target.value) }));
  at("pause").addEventListener("click", () => tell({ do: "pause", on: !(last && last.paused) }));
  at("reset").addEventListener("click", () => location.reload(tell({ do: "reset" })));

  traces = {
    error: trace("position error", "mm", ["position"]),
    angle: trace("rotation error", "deg", ["rotation"]),
    torque: trace("torque", "N m", [0, 1, 2, 3, 4, 5].map((leg) => `leg ${leg}`)),
  };
  if (about.setting) traces.setting = trace("tuner's setting", "decades", ["speed", "damping", "integral", "disturbance"]);

  let stale = true;
  new EventSource("events").onmessage = ({ data }) => {
    last = JSON.parse(data);
    at("clock").textContent = `${last.time.toFixed(1)} s`;
    at("factor").textContent = last.paused ? "paused" : `× ${last.factor.toFixed(2)}`;
    at("pause").textContent = last.paused ? "Go on" : "Pause";
    at("message").textContent = last.ended ? `ended: ${last.ended} (Reset begins anew)` : last.message;
    at("message").className = last.ended ? "ended" : "";
    if (!held) sliders.forEach(({ input, write }, k) => { input.value = last.target[k] * AXES[k][2]; write(); });
    traces.error.add(last.time, [last.position_mm]);
    traces.angle.add(last.time, [last.rotation_deg]);
    traces.torque.add(last.time, last.torque);
    // Not every controller has a tuner.
    at("kappa-label").hidden = about.kappa === null || !last.setting;
    if (traces.setting) traces.setting.box.hidden = !last.setting;
    if (traces.setting && last.setting) traces.setting.add(last.time, last.setting.slice(0, 4));
    stale = true;
  };
  const draw = () => {
    if (stale) Object.values(traces).forEach((each) => each.draw());
    stale = false;
    requestAnimationFrame(draw);
  };
  draw();
}

begin();
