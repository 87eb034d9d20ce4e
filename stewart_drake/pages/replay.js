"use strict";

const COLOURS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00"];
const runs = JSON.parse(document.getElementById("data").textContent);
const at = (id) => document.getElementById(id);
const end = Math.max(...runs.map((run) => run.time.at(-1)));
let time = 0, playing = true, before = null;

const frames = runs.map((run) => {
  const box = document.createElement("article");
  box.className = "run";
  const [title, frame] = [document.createElement("h2"), document.createElement("iframe")];
  title.textContent = run.name;
  box.append(title);
  for (const [text, bad] of run.lines) {
    const line = document.createElement("p");
    line.textContent = text;
    if (bad) line.className = "bad";
    box.append(line);
  }
  frame.title = `the robot of ${run.name}`;
  frame.srcdoc = run.page;
  frame.addEventListener("load", () => {
    const { viewer } = frame.contentWindow;
    viewer.gui.domElement.style.display = "none";
    viewer.animator.pause();
    viewer.animator.seek(time);
  });
  box.append(frame);
  at("runs").append(box);
  return frame;
});

function trace(title, names, tables) {
  const box = document.createElement("div");
  box.className = "trace";
  at("traces").append(box);
  const value = (_, number) => (number == null ? "--" : number.toPrecision(3));
  const plot = new uPlot({
    title, width: box.clientWidth - 12, height: 200, scales: { x: { time: false, range: [0, end] } },
    cursor: { y: false, drag: { x: false, y: false } },
    axes: [
      { label: "time [s]", labelSize: 18, size: 34 },
      { size: 62, values: (_, ticks) => ticks.map((tick) => String(Number(tick.toPrecision(6)))) },
    ],
    series: [{ label: "t [s]", value }, ...names.map((label, k) =>
      ({ label, value, stroke: COLOURS[k % COLOURS.length], width: 1.5, spanGaps: true, points: { show: false } }))],
  }, uPlot.join(tables), box);
  plot.over.addEventListener("click", (event) => go(plot.posToVal(event.offsetX, "x")));
  new ResizeObserver(() => plot.setSize({ width: box.clientWidth - 12, height: 200 })).observe(box);
  return plot;
}

const names = runs.map((run) => run.name);
const plots = [
  trace("position error [mm]", names, runs.map((run) => [run.time, run.position_mm])),
  trace("rotation error [deg]", names, runs.map((run) => [run.time, run.rotation_deg])),
  ...runs.filter((run) => run.torque.length).map((run) => trace(runs.length > 1 ? `torque of ${run.name} [N m]` : "torque [N m]",
    run.torque.map((_, leg) => `leg ${leg}`), [[run.time, ...run.torque]])),
];

function show() {
  for (const frame of frames) {
    const viewer = frame.contentWindow && frame.contentWindow.viewer;
    if (viewer && viewer.animator) viewer.animator.seek(time);
  }
  for (const plot of plots) plot.setCursor({ left: plot.valToPos(time, "x"), top: 10 }, false);
  at("scrub").value = time;
  at("clock").textContent = `${time.toFixed(2)} of ${end.toFixed(2)} s`;
}

function go(to) {
  time = Math.min(Math.max(to, 0), end);
  show();
}

function play(on) {
  playing = on;
  if (on && time >= end) time = 0;
  at("play").textContent = on ? "Pause" : "Play";
}

at("scrub").max = end;
at("scrub").addEventListener("input", (event) => { play(false); go(Number(event.target.value)); });
at("play").addEventListener("click", () => play(!playing));
document.addEventListener("keydown", (event) => {
  if (event.code === "Space" && event.target === document.body) { event.preventDefault(); play(!playing); }
});

function tick(now) {
  if (playing && before !== null) {
    time += (now - before) / 1000 * Number(at("speed").value);
    if (time > end) {
      if (at("loop").checked) time = 0; else { time = end; play(false); }
    }
    show();
  }
  before = now;
  requestAnimationFrame(tick);
}

show();
requestAnimationFrame(tick);
