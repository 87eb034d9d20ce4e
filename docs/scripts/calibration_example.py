"""Makes the example of a calibration in diagrams/calibration/: `python docs/scripts/calibration_example.py`.

poses.csv is what a tracker and encoders of 14 bits say of a hobby hexapod that is off by up to a millimetre and a
milliradian in every parameter, at 60 planned poses; the robot as believed is `servo_hexapod`, the truth is truth.yaml.
"""

import math
from pathlib import Path

import numpy as np
from simulated_calibration import aligned, deviating, measured

from stewart_drake.base.yaml_files import to_yaml
from stewart_drake.estimation.geometry import exponential, transform
from stewart_drake.estimation.poses import MeasurementNoise, plan_poses
from stewart_drake.robot.robot_files import load_robot
from stewart_drake.scenario.scenario import load_scenario

FOLDER = Path(__file__).parents[2] / "diagrams" / "calibration"
ROBOT, POSES, SEED = "servo_hexapod", 60, 11


def main():
    """Writes poses.csv and truth.yaml."""
    guess, rng = load_robot(ROBOT), np.random.default_rng(SEED)
    noise = MeasurementNoise(encoder=2.0 * math.pi / 2**14 / math.sqrt(12.0))
    limits = load_scenario("paper_fig7", [f"robot={ROBOT}"]).limits
    truth = deviating(guess, rng)
    base = transform(exponential(np.array([0.1, -0.2, 2.0])), np.array([0.8, 0.3, -0.4]))
    marker = transform(exponential(np.array([0.1, 0.2, 0.5])), np.array([0.01, 0.02, 0.05]))
    poses = measured(truth, plan_poses(guess, POSES, limits, noise).targets, noise, rng, base, marker)
    (FOLDER / "poses.csv").write_text(poses.to_csv(), encoding="utf-8")
    about = "the robot of which poses.csv is; shafts and joints laid on those of servo_hexapod"
    (FOLDER / "truth.yaml").write_text(to_yaml({"about": about, **aligned(truth, guess).to_dict()}), encoding="utf-8")


if __name__ == "__main__":
    main()
