"""Draws docs/images/ball.svg, what a late sensor does to a ball: `python docs/scripts/draw_ball.py`."""

from pathlib import Path

import matplotlib.pyplot as plt
import numpy as np

from stewart_drake import load_scenario, run

LATE = (("expected", 0.04, "C0"), ("not expected", 0.0, "C1"))  # What the controller believes [s].

plt.rcParams["svg.hashsalt"] = "ball"  # the same picture again, to the byte
figure, (plate, distance) = plt.subplots(1, 2, figsize=(9, 3.4), width_ratios=(1, 2), layout="constrained")
for label, believed, colour in LATE:
    sensors = {"ball.sensor": {"preset": "camera"}, "model.ball": {"sensor": {"preset": "camera", "delay": believed}}}
    log = run(load_scenario("ball").replace(sensors))
    target = log.scenario.ball_control.target.evaluate(log.time)[:, :2]
    rows = slice(0, None, 20)
    away, circle = 1e3 * np.linalg.norm(log["ball"] - target, axis=1)[rows], log.time[rows] > 11.0
    distance.plot(log.time[rows], away, colour, label=label)
    plate.plot(*(1e3 * log["ball"][rows][circle]).T, colour)
plate.plot(*(1e3 * target[rows][circle]).T, "k:", label="target")
plate.set(xlabel="x [mm]", ylabel="y [mm]", aspect="equal", title="on the circle, from 11 s on")
distance.set(xlabel="time [s]", ylabel="distance from the target [mm]", title="a camera's readings are 40 ms late")
distance.legend(frameon=False)
plate.legend(frameon=False, loc="center")
for axes in (plate, distance):
    axes.spines[["top", "right"]].set_visible(False)
figure.savefig(Path(__file__).parents[1] / "images" / "ball.svg", metadata={"Date": None})
