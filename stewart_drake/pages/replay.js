"use strict";

const runs = JSON.parse(document.getElementById("data").textContent);
const at = (id) => document.getElementById(id);
const end = Math.max(...runs.map((run) => run.time.at(-1)));
let time = 0, playing = true, before = null;

const scenes = runs.map((run) => {
  const article = document.createElement("article");
  article.className = "run";
  const [title, box] = [document.createElement("h2"), document.createElement("div")];
  title.textContent = run.name;
  article.append(title);
  for (const [text, bad] of run.lines) {
    const line = document.createElement("p");
    line.textContent = text;
    if (bad) line.className = "bad";
    article.append(line);
  }
  box.className = "robot";
  box.setAttribute("role", "img");
  box.setAttribute("aria-label", `the robot of ${run.name}`);
  article.append(box);
  at("runs").append(article);
  const bytes = Uint8Array.from(atob(run.links), (character) => character.charCodeAt(0));
  return { view: new RobotScene(box, run.scene), frames: run.frames, poses: new Float32Array(bytes.buffer) };
});

/** Shows a scene at a time between two of its frames. */
function seek({ view, frames, poses }, when) {
  const count = frames.length, size = poses.length / count;
  let [low, high] = [0, count - 1];
  while (high - low > 1) {
    const middle = (low + high) >> 1;
    if (frames[middle] <= when) low = middle; else high = middle;
  }
  const share = high > low ? Math.min(Math.max((when - frames[low]) / (frames[high] - frames[low]), 0), 1) : 0;
  const frame = (k) => poses.subarray(k * size, (k + 1) * size);
  view.place(frame(low), frame(high), share);
}

function trace(title, unit, names, tables) {
  const { plot } = tracePlot(at("traces"), title, unit, names, uPlot.join(tables),
    { scales: { x: { time: false, range: [0, end] } }, cursor: { y: false, drag: { x: false, y: false } } });
  plot.over.addEventListener("click", (event) => go(plot.posToVal(event.offsetX, "x")));
  return plot;
}

const names = runs.map((run) => run.name);
const balls = runs.filter((run) => run.ball_m);
const plots = [
  ...(balls.length ? [trace("ball's distance from its target", "m", balls.map((run) => run.name), balls.map((run) => [run.time, run.ball_m]))] : []),
  trace("position error", "m", names, runs.map((run) => [run.time, run.position_m])),
  trace("rotation error", "deg", names, runs.map((run) => [run.time, run.rotation_deg])),
  ...runs.filter((run) => run.torque.length).map((run) => trace(runs.length > 1 ? `torque of ${run.name}` : "torque", "N m",
    run.torque.map((_, leg) => `leg ${leg}`), [[run.time, ...run.torque]])),
];

function show() {
  for (const scene of scenes) seek(scene, time);
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
