"""Wrong encoders with and without an inertial sensor, docs/results/parity.md: `make results/parity`, a minute."""

from pathlib import Path

import numpy as np

from stewart_drake import Scenario, load_scenario, run
from stewart_drake.base.markdown import markdown_table
from stewart_drake.logs.log import SimulationLog
from stewart_drake.mechanics.kinematics import rotation_matrix

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
TEXT = """# An encoder that is wrong, and an inertial sensor that contradicts it

Six readings for six degrees of freedom never contradict each other. How far does the robot go if one of them is wrong,
with and without an inertial sensor (BMI088) on the platform? Command: `make results/parity`.

{table}

- Encoder {leg} is wrong from {onset:g} s on; runs of {duration:g} s on the closed form, with the safety layer. The
  numbers are the farthest true pose from the reference.
- *parity*: the orientation by the encoders and that by the inertial sensor differ by more than 1 deg (`safety.parity`).
  The direction of the difference names the leg; *leg -* where it fits none well enough.
- Here the robot stops (`on_lost_encoder: stop`), and brakes must close within 40 ms. By default it is
  [held on five encoders](lost_encoder.md).
"""


def farthest(log: SimulationLog) -> tuple[float, float]:
    """[deg], [mm] of the true pose from the reference after the onset."""
    after = log["time"] >= min(ONSET, log["time"][-1])
    pose, wanted = log["pose"][after], log["reference"][after]
    between = np.swapaxes(rotation_matrix(wanted[:, :3]), -1, -2) @ rotation_matrix(pose[:, :3])
    angle = np.arccos(np.clip(0.5 * (np.trace(between, axis1=1, axis2=2) - 1.0), -1.0, 1.0))
    return float(np.degrees(angle.max())), float(1e3 * np.linalg.norm(pose[:, 3:] - wanted[:, 3:], axis=1).max())


def cell(scenario: Scenario) -> str:
    """What became of a run."""
    log = run(scenario, check=False)
    trip, (angle, distance) = log.safety, farthest(log)
    seen = "" if not scenario.sensors.faults else "unnoticed; " if log.status == "completed" else f"{log.status}; "
    if trip is not None and trip["stopped"] is not None:
        leg = "-" if trip["stopped"]["leg"] is None else trip["stopped"]["leg"]
        seen = f"{trip['stopped']['monitor']}, leg {leg}, after {trip['stopped']['time'] - ONSET:.2f} s; "
    return f"{seen}{angle:.2g} deg, {distance:.2g} mm"


def main() -> None:
    """Runs, and writes the page."""
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
    head = ["motion", f"encoder {LEG}", "without the sensor", "with it"]
    table = markdown_table(head, rows)
    PAGE.write_text(TEXT.format(table=table.strip(), leg=LEG, onset=ONSET, duration=DURATION), encoding="utf-8")


if __name__ == "__main__":
    main()
