"""Two faults at once, and false trips, with an inertial sensor: docs/results/parity.md.

`make results/parity`: ten minutes on one core. A number is the share of the healthy motions, for a trial.
"""

import sys
from pathlib import Path

import false_trips
import numpy as np

from stewart_drake import Scenario, load_scenario, run
from stewart_drake.base.markdown import markdown_table
from stewart_drake.logs.log import SimulationLog
from stewart_drake.studies.faults import travel

PAGE = Path(__file__).parents[1] / "results" / "parity.md"
ONSET, DURATION, LEG = 2.0, 10.0, 2  # [s], [s]
SENSORS = {"kind": "encoders", "resolution_bits": 17, "noise": 2e-5}
CLOSED_FORM = {"plant": "closed_form", "safety": {"on_lost_encoder": "stop"}, "duration": DURATION}
MINI = {"kind": "closed_form", "motor_damping": 0.095, "motor_friction": 0.058}
SETUPS = {
    "breathing": ("exact_breathing", {**CLOSED_FORM, "sensors": SENSORS}),
    "at rest": ("exact_breathing", {**CLOSED_FORM, "sensors": SENSORS, "reference": {"kind": "hold"}}),
    "Reachy Mini nods, 100 Hz": (
        "reachy_nod",
        {"plant": MINI, "safety": {"on_lost_encoder": "stop"}, "duration": DURATION},
    ),
}
FAULTS = {
    "drifts by 0.3 rad/s": {"kind": "drift", "size": 0.3},
    "drifts by 0.01 rad/s": {"kind": "drift", "size": 0.01},
    "freezes": {"kind": "freeze"},
    "jumps by 0.1 rad": {"kind": "jump", "size": 0.1},
}
LATER, HOLD = ONSET + 3.0, 6.0  # [s] of a second fault, while the robot is held; of the safe hold.
DRIFT = {"kind": "drift", "time": ONSET, "leg": LEG, "size": 0.1}
JUMP, GYRO = {**DRIFT, "kind": "jump"}, {"kind": "jump", "channel": "gyro_x", "size": 0.1}
PAIRS: dict[str, tuple[list[dict[str, object]], list[dict[str, object]]]] = {
    "2 and 4 drift": ([DRIFT, {**DRIFT, "leg": 4, "size": -0.07}], []),
    "2 and 4 jump": ([JUMP, {**JUMP, "leg": 4, "size": -0.07}], []),
    "all six freeze": ([{"kind": "freeze", "time": ONSET}], []),
    "2 drifts, a gyroscope jumps": ([DRIFT], [{**GYRO, "time": ONSET}]),
    "2 drifts, then 4 drifts": ([DRIFT, {**DRIFT, "leg": 4, "time": LATER}], []),
    "2 drifts, then 4 freezes": ([DRIFT, {"kind": "freeze", "leg": 4, "time": LATER}], []),
    "2 drifts, then the sensor is dead": ([DRIFT], [{"kind": "nan", "time": LATER}]),
    "the sensor is dead, then 2 drifts": ([{**DRIFT, "time": LATER}], [{"kind": "nan", "time": ONSET}]),
}
TEXT = """# An encoder that is wrong, and an inertial sensor that contradicts it

Six readings for six degrees of freedom never contradict each other. How far does the robot go if one of them is wrong,
with and without an inertial sensor (BMI088) on the platform? Command: `make results/parity`. More faults:
[the table](faults.md), [random ones](random_faults.md); then the robot [goes on with five encoders](lost_encoder.md).

{table}

- Encoder {leg} is wrong from {onset:g} s on; runs of {duration:g} s on the closed form, with the safety layer. The
  numbers are the farthest true pose from the reference, or from where the robot is to stop, until brakes hold it.
- *parity*: the orientation by the encoders and that by the inertial sensor differ by more than 1 deg (`safety.parity`).
  The direction of the difference names the leg; *leg -* where it fits none well enough.
- Here the robot stops (`on_lost_encoder: stop`), and brakes must close within 40 ms. By default it is
  [held on five encoders](lost_encoder.md).

## Two faults

`safety: {{safe_hold_time: {hold:g}}}`; *then*: {between:g} s after the first, while the robot is held.

{pairs}

**What is promised:** with two faults the robot is stopped, and a second fault ends a hold on five encoders. The leg
that is named may be wrong, and so is the pose in which the robot is held: brakes must close at once. A frozen encoder
of a robot that is held is right.

## False trips

Healthy readings of {seconds} s in sum: {trips} trips of the comparison.

{healthy}

- *Readings*: the comparison alone, on synthetic ones. Random motions with blows; BMI088, BNO085 and MPU-6050 with the
  offsets, drift, scales, noise and steps of their data sheets; encoders homed with 2 mrad, a mounting off by 0.3 deg
  (standard deviations), a base that leans by up to 1 deg.
- *Loops*: pushes of a tenth of the platform's weight, payloads up to a fifth, friction wrong by up to 30 %.
- Nearest to a trip is the MPU-6050, with the largest drift and scale errors of the three: it takes a scale that is 5 %
  off, on a platform that turns in the first half second, for an offset.

A base that shakes, and [that nobody measures](../moving_base.md), is felt by the inertial sensor alone. Up to this
motion along x the comparison does not trip within a minute; paper's robot at rest, 100 Hz, BMI088. A vehicle or a ship
has more, and needs `base.sensor`.

{shaken}
"""


def seen(log: SimulationLog) -> str:
    """What became of a run, and [deg], [mm] of the true pose from where it should have been."""
    trip, (angle, distance) = log.safety, np.array(travel(log, ONSET)) * (np.degrees(1.0), 1e3)
    where = f"{angle:.2g} deg, {distance:.2g} mm"
    if trip is None:
        return f"{'unnoticed; ' if log.scenario.sensors.faults else ''}{where}"
    trips = [trip] if trip["stopped"] is None or trip["stopped"]["time"] == trip["time"] else [trip, trip["stopped"]]
    named = (
        f"{each['monitor']}, leg {'-' if each['leg'] is None else each['leg']}, after {each['time'] - ONSET:.2f} s"
        for each in trips
    )
    return f"{'; then '.join(named)}; {where}"


def cell(scenario: Scenario) -> str:
    """The same of a scenario."""
    return seen(run(scenario, check=False))


def fault_rows() -> list[list[str]]:
    """One wrong encoder, without the sensor and with it."""
    rows = []
    for setup_name, (name, changes) in SETUPS.items():
        scenario = load_scenario(name).replace(changes)
        for fault_name, fault in {"none": None, **FAULTS}.items():
            faults = [] if fault is None else [{**fault, "time": ONSET, "leg": LEG}]
            cells = [
                cell(scenario.replace({"sensors.imu": imu, "sensors.faults": faults}))
                for imu in (None, {"preset": "bmi088"})
            ]
            rows.append([setup_name, fault_name, *cells])
            print(rows[-1], flush=True)
    return rows


def pair(setup: str, encoders: list[dict[str, object]], sensor: list[dict[str, object]]) -> str:
    """What becomes of two faults."""
    name, changes = SETUPS[setup]
    keys = {"sensors.imu": {"preset": "bmi088", "faults": sensor}, "sensors.faults": encoders}
    return cell(load_scenario(name).replace({**changes, "safety": {"safe_hold_time": HOLD}}).replace(keys))


def main() -> None:
    """Runs, and writes the page."""
    share = float(sys.argv[1]) if len(sys.argv) > 1 else 1.0
    head = ["motion", f"encoder {LEG}", "without the sensor", "with it"]
    table = markdown_table(head, fault_rows())
    setups = ("breathing", "Reachy Mini nods, 100 Hz")
    pairs = [[name, *(pair(setup, *faults) for setup in setups)] for name, faults in PAIRS.items()]
    healthy = [*false_trips.kernel_rows(share, 1), *false_trips.loop_rows(share, 1)]
    text = TEXT.format(
        table=table.strip(),
        leg=LEG,
        onset=ONSET,
        duration=DURATION,
        hold=HOLD,
        between=LATER - ONSET,
        pairs=markdown_table(("encoders", *setups), pairs).strip(),
        seconds=f"{sum(float(row[1]) for row in healthy):.3g}",
        trips=sum(int(row[3]) for row in healthy),
        healthy=markdown_table(("healthy", "time [s]", "motions", "trips"), healthy).strip(),
        shaken=markdown_table(
            ("frequency [Hz]", "amplitude [mm]", "acceleration [m/s^2]"), false_trips.shaken_rows()
        ).strip(),
    )
    PAGE.write_text(text, encoding="utf-8")


if __name__ == "__main__":
    main()
