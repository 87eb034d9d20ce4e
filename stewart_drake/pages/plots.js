"use strict";

const COLOURS = ["#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00"];
const PREFIXES = [["", 1], ["m", 1e-3], ["µ", 1e-6], ["n", 1e-9], ["p", 1e-12]];
const WITHOUT_PREFIX = new Set(["decades", "s", "deg"]); // nobody reads a millidegree

/** A prefix and its size in which a value of a unit has one to three digits before its point. */
function prefixOf(value, unit) {
  if (!value || WITHOUT_PREFIX.has(unit)) return PREFIXES[0];
  return PREFIXES.find(([, size]) => Math.abs(value) >= size) ?? PREFIXES.at(-1);
}

/** `0.42 µm`: a value with the prefix that suits it, or that suits `largest`. */
function measured(value, unit, digits = 3, largest = value) {
  if (value == null) return "--";
  const [prefix, size] = prefixOf(largest, unit);
  return `${Number((value / size).toPrecision(digits))} ${prefix}${unit}`;
}

/** Room for the longest label of an axis; uPlot asks again until it stays. */
function roomFor(plot, labels, axis, round) {
  const { _size, ticks, gap, font } = plot.axes[axis];
  if (round > 1) return _size;
  plot.ctx.font = font[0];
  const widths = (labels ?? []).map((label) => plot.ctx.measureText(label).width / devicePixelRatio);
  return Math.ceil(Math.max(56, ticks.size + gap + Math.max(0, ...widths)));
}

/** A plot of values in base units over time, in a box of its own below `parent`; it `fits` a box of given height. */
function tracePlot(parent, title, unit, names, data, { fits = false, kind = "", colours = COLOURS, ...more } = {}) {
  const box = document.createElement("div");
  box.className = `trace ${kind}`;
  parent.append(box);
  const besides = () => [...box.querySelectorAll(".u-title, .u-legend")].reduce((sum, part) => sum + part.offsetHeight, 14);
  const size = () => ({ width: box.clientWidth - 12, height: fits ? Math.max(60, box.clientHeight - besides()) : 200 });
  const value = (_, number) => measured(number, unit);
  const plot = new uPlot({
    title, ...size(), scales: { x: { time: false } }, ...more,
    axes: [
      { label: "time [s]", labelSize: 18, size: 34, space: 60, values: (_, ticks) => ticks.map((tick) => Number(tick.toPrecision(8))) },
      {
        size: roomFor, space: 18,
        values: (_, ticks) => ticks.map((tick) => measured(tick, unit, 6, Math.max(...ticks.map(Math.abs)))),
      },
    ],
    series: [{ label: "t", value: (_, number) => measured(number, "s", 6) }, ...names.map((label, k) =>
      ({ label, value, stroke: colours[k % colours.length], width: 1.5, spanGaps: true, points: { show: false } }))],
  }, data, box);
  new ResizeObserver(() => plot.setSize(size())).observe(box);
  return { box, plot };
}
