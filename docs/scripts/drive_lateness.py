"""How late commands are: `python docs/scripts/drive_lateness.py [SECONDS]` drives a simulated robot at 1 kHz over UDP.

Late is a command that reaches the robot's side more than 1 ms after the reading that it answers.
"""

import sys

import numpy as np

from stewart_drake import load_scenario
from stewart_drake.machines.simulated import SimulatedMachine
from stewart_drake.runs.drive import Drive, connected

SCENARIO = ["plant.kind=closed_form", "sensors=encoders", "controller.period=0.001", "plant.time_step=0.001"]


def main() -> None:
    """Drives, and prints what was late."""
    seconds = float(sys.argv[1]) if len(sys.argv) > 1 else 600.0
    scenario = load_scenario("exact_fig7", SCENARIO)
    machine = SimulatedMachine(scenario)
    log = Drive(scenario, machine, connected(scenario, machine, seconds)).run()
    late, counts = 1e3 * log["lateness"], machine.counts
    commands = max(counts["accepted"], 1)
    print(f"{log.status} {log.message or ''}: {log.end_time:.1f} s, {len(log.time)} ticks, {commands} commands")
    shares = {name: counts.get(name, 0) / commands for name in ("late", "missing", "old", "range", "garbage")}
    print("of the commands: " + ", ".join(f"{name} {share:.3%}" for name, share in shares.items()))
    quantiles = ", ".join(f"{share:.1%} {np.quantile(late, share):.3f}" for share in (0.5, 0.99, 0.999, 1.0))
    print(f"lateness of a tick [ms]: {quantiles}")


if __name__ == "__main__":
    main()
