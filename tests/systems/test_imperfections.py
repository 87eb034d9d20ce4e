"""Disturbances and imperfections in the plant and the loop."""

import numpy as np
import pytest
from pydrake.systems.analysis import Simulator
from strategies import ROBOT

from stewart_drake.mechanics.dynamics import STANDARD_GRAVITY, static_torque
from stewart_drake.mechanics.kinematics import rotation_matrix, twist_jacobian
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario

POSE = np.array([0.1, -0.15, 0.2, 0.02, -0.01, 0.31])
SPLIT = {"period": 0.001, "model": "exact", "solver": "split", "weight_length": 0.11}
BASE = {
    "duration": 0.1,
    "reference": {"kind": "hold", "pose": POSE.tolist()},
    "controller": SPLIT,
    "tuner": {"kind": "block", "q_pose": 4e5, "q_rate": 30.0, "q_integral": 4e7},
}


def scenario(**changes):
    return Scenario.from_dict(BASE | changes)


def payload_torque(mass, position, pose):
    """Torques that carry a point mass on the platform, by virtual work: T = J^-T w."""
    arm = rotation_matrix(pose[:3]) @ position
    up = np.array([0.0, 0.0, mass * STANDARD_GRAVITY])
    return np.linalg.solve(twist_jacobian(ROBOT, pose).T, np.concatenate([np.cross(arm, up), up]))


def drift(plant_options, torque, seconds=0.05):
    """Way of the platform from rest under constant torques: (6,)."""
    diagram, plant = build_plant(ROBOT, plant_options)
    simulator = Simulator(diagram)
    context = simulator.get_mutable_context()
    plant.set_state(context, POSE)
    diagram.get_input_port(0).FixValue(context, torque)
    simulator.AdvanceTo(seconds)
    return plant.pose_and_rate(diagram.get_output_port(0).Eval(context))[0] - POSE


def test_a_payload_is_carried_by_the_torques_of_statics_and_by_no_others():
    position = np.array([0.05, -0.02, 0.03])
    options = PlantOptions(payload_mass=0.3, payload_position=tuple(position))
    weight = static_torque(ROBOT, POSE)
    assert np.abs(drift(options, weight + payload_torque(0.3, position, POSE))).max() < 1e-6
    assert np.abs(drift(options, weight)).max() > 1e-3
    # Off centre it is another load than at the centre.
    assert np.abs(drift(options, weight + payload_torque(0.3, np.zeros(3), POSE))).max() > 1e-4


@pytest.mark.slow
def test_a_rod_breaks_at_its_time_and_alone_and_not_after_the_end():
    late = run(scenario(plant={"broken_rod": {"leg": 3, "time": 1e308}}))
    np.testing.assert_array_equal(late["plant_state"], run(scenario())["plant_state"])
    log = run(scenario(plant={"broken_rod": {"leg": 3, "time": 0.0705}}))
    assert np.delete(log["loop_gap"], 3, axis=1).max() < 1e-4
    assert log["loop_gap"][:72, 3].max() < 1e-6
    assert log["loop_gap"][76:, 3].min() > 1e-6
    assert log["loop_gap"][-1, 3] > 1e-4
