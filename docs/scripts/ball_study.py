"""How well a ball is balanced, and by what, and docs/results/ball.md: `make results/ball`."""

from pathlib import Path

import numpy as np

from stewart_drake import load_scenario, run
from stewart_drake.base.markdown import markdown_table

OUT = Path(__file__).parents[1] / "results" / "ball.md"
NEAR = 0.005  # [m] from the target, within which a ball counts as settled.
COLUMNS = ("settled [s]", "thrown off by [mm]", "settled again [s]", "RMS on the circle [mm]", "RMS tilt error [deg]")
TENNIS = {"ball.preset": "table_tennis", "ball.sensor": {"preset": "camera"}}
SLOW = {"controller.period": 0.01, "ball.sensor.period": 0.01}
COARSE = {"sensors": {"kind": "encoders", "resolution_bits": 12}, **SLOW}
GRAVITY = {"controller.feedforward": "gravity"}
ROWS = {
    "paper's robot, steel ball, touch screen": ("ball", {}),
    "the same on Drake's plant, with contact": ("ball", {"plant.kind": "drake"}),
    "the same, a camera 40 ms late": ("ball", {"ball.sensor": {"preset": "camera"}}),
    "the same, a table tennis ball": ("ball", TENNIS),
    "hobby servos at 50 Hz, table tennis ball, camera": ("ball_hexapod", {}),
    "the same, readings 20 ms late": ("ball_hexapod", {"ball.sensor.delay": 0.02}),
    "the same, angles of the inverse kinematics alone": ("ball_hexapod", {"controller.feedforward": "none"}),
}
INNER = {
    "1 kHz, inverse dynamics of the reference": ("ball", {}),
    "1 kHz, weight alone": ("ball", GRAVITY),
    "100 Hz, inverse dynamics of the reference": ("ball", SLOW),
    "100 Hz, weight alone": ("ball", {**SLOW, **GRAVITY}),
    "100 Hz and 12 bits, inverse dynamics": ("ball", COARSE),
    "100 Hz and 12 bits, weight alone": ("ball", {**COARSE, **GRAVITY}),
    "100 Hz and 12 bits, inverse dynamics, inertial sensor": (
        "ball",
        {**COARSE, "sensors": {**COARSE["sensors"], "imu": {}}},
    ),
}
TEXT = """# A ball on the platform

How well is a ball balanced, by which robot, and what does the inner loop add?
Command: `make results/ball`, two minutes. Scenarios: `ball`, `ball_hexapod`.

A ball starts {start:g} mm off the centre, on the hexapod {slow_start:g} mm; is thrown at 3 s by {throw:.2f} or
{slow_throw:.2f} m/s; and from 7 s on follows a circle of {circle:g} mm in {turn:g} s, or {slow_circle:g} mm in
{slow_turn:g} s.
Settled: from then on within {near:g} mm. The circle counts after its first turn.

{rows}

- The loop tilts the platform by at most 8 deg: from 50 mm a ball needs at least {least:.2f} s, at full tilt one way
  and then the other.
- On Drake's plant the ball is a body in contact with friction; the closed form's ball cannot slip. Their paths differ
  by {apart:.1f} mm at most.
- A table tennis ball has more rolling resistance. The controller counts with it along the circle, not at rest.

## The inner loop

The paper's robot with the steel ball, and other inner loops.

{inner}

- The outer loop gives a reference with rate and acceleration. An inner loop with exact inverse dynamics follows it
  {better:.0f} times closer at 100 Hz than one that knows only the weight. The ball's loop hides most of the rest.
"""


def figures(log):
    """The columns of a run."""
    target = log.scenario.ball_control.target
    away = np.linalg.norm(log["ball"] - target.evaluate(log.time)[:, :2], axis=1)
    (throw,) = log.scenario.ball.throws

    def settled(begin, end):
        outside = np.flatnonzero((away > NEAR) & (log.time >= begin) & (log.time < end))
        return log.time[outside[-1]] - begin if len(outside) else 0.0

    circle = log.time >= target.begin + target.turn_time
    thrown = (log.time >= throw.time) & (log.time < target.begin)
    rms = 1e3 * np.sqrt(np.mean(away[circle] ** 2))
    tilt = np.degrees(np.sqrt(np.mean(np.sum(log.error[:, :2] ** 2, axis=1))))
    return settled(0.0, throw.time), 1e3 * away[thrown].max(), settled(throw.time, target.begin), rms, tilt


def row(name, log):
    """A line of a table."""
    assert log.status == "completed", (name, log.message)
    first, off, again, rms, tilt = figures(log)
    return [name, f"{first:.2f}", f"{off:.0f}", f"{again:.2f}", f"{rms:.2f}", f"{tilt:.3f}"]


def run_all(rows):
    """Logs by name."""
    return {name: run(load_scenario(scenario).replace(changes)) for name, (scenario, changes) in rows.items()}


def main():
    """Writes the page."""
    logs, inner = run_all(ROWS), run_all(INNER)
    exact, contact = list(logs.values())[:2]
    fast, slow = (load_scenario(name) for name in ("ball", "ball_hexapod"))
    pull = fast.ball.per_tilt(9.81)[0] * fast.ball_control.max_tilt
    tilts = {name: figures(log)[-1] for name, log in inner.items()}
    words = {}
    for prefix, scenario in (("", fast), ("slow_", slow)):
        (throw,), target = scenario.ball.throws, scenario.ball_control.target
        words |= {f"{prefix}start": 1e3 * scenario.ball.start[0], f"{prefix}throw": np.hypot(*throw.velocity)}
        words |= {f"{prefix}circle": 1e3 * target.radius, f"{prefix}turn": target.turn_time}
    words |= {"near": 1e3 * NEAR, "least": 2.0 * np.sqrt((fast.ball.start[0] - NEAR) / pull)}
    words["apart"] = 1e3 * np.linalg.norm(exact["ball"] - contact["ball"], axis=1).max()
    words["better"] = tilts["100 Hz, weight alone"] / tilts["100 Hz, inverse dynamics of the reference"]
    tables = {
        key: markdown_table(("loop", *COLUMNS), [row(name, log) for name, log in found.items()])
        for key, found in (("rows", logs), ("inner", inner))
    }
    OUT.write_text(TEXT.format(**words, **tables))


if __name__ == "__main__":
    main()
