import numpy as np
import pytest
from plant_runs import Run
from strategies import ROBOT, UNEQUAL

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.plant.closed_chain import ClosedChain
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot.leg import FrictionOptions
from stewart_drake.robot.robot_files import load_robot

SIGNS = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
SMALL = load_robot("reachy_mini")


def test_the_rotors_keep_their_inertia_beside_friction():
    """Drake takes the rotor of a joint from one of its actuators."""
    masses = []
    for options in ({}, {"motor_friction": 0.1}, {"friction": FrictionOptions(coulomb=(0.1, 0.0) * 3)}):
        plant = Run(robot=UNEQUAL, **options).stewart.plant
        masses.append(plant.CalcMassMatrix(plant.CreateDefaultContext()))
    for other in masses[1:]:
        np.testing.assert_allclose(other, masses[0], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("ratio", [0.5, 0.98])
@pytest.mark.parametrize("share", [1.0, 0.5], ids=["coulomb", "stribeck"])
@pytest.mark.parametrize(
    ("robot", "break_away", "viscous"),
    [(ROBOT, 0.5, 0.0), (UNEQUAL, 0.3, 0.0), (SMALL, 0.058, 0.095)],
    ids=["strong", "unequal", "small"],
)
def test_below_break_away_a_motor_yields_5e_6_rad_at_most_and_then_rests(robot, break_away, viscous, share, ratio):
    said = FrictionOptions(coulomb=share * break_away, break_away=break_away, stribeck_velocity=0.02, viscous=viscous)
    run = Run(robot=robot, friction=said)
    # The closed loops of the plant stand a little off: what is left of the load beside friction is known to 1e-3.
    run.hold(static_torque(robot, robot.home_pose) + ratio * break_away * SIGNS)
    start, yielded = run.angles, 0.0
    for step in range(1, 11):
        yielded = max(yielded, np.abs(run.to(0.01 * step).angles - start).max())
    assert yielded <= 5e-6
    assert np.abs(run.rates).max() < 1e-8
    rested = run.angles
    for step in range(1, 11):
        run.to(0.1 + 0.01 * step)
        assert np.abs(run.rates).max() < 1e-8
    assert np.abs(run.angles - rested).max() / 0.1 < 1e-8


@pytest.mark.slow
@pytest.mark.parametrize("robot", [ROBOT, SMALL], ids=["paper", "small"])
def test_the_closed_chain_with_the_same_friction_sticks_and_slips_alike(robot):
    """Back and forth over break-away; the two differ to first order in the step."""
    hold = static_torque(robot, robot.home_pose)
    said = FrictionOptions(coulomb=0.04, break_away=0.06, stribeck_velocity=0.05, viscous=0.02)
    errors = []
    for step in (2e-3, 1e-3):
        chain = ClosedChain(robot, PlantOptions(friction=said, time_step=step), 9.81)
        state, run = chain.initial(robot.home_pose, np.zeros(6)), Run(robot=robot, time_step=step, friction=said)
        poses, model = [], []
        for k in range(round(0.5 / step)):
            torque = hold + 0.1 * np.sin(2.0 * np.pi * 2.0 * k * step)
            chain.step(torque, np.zeros(6), state)
            model.append(state["pose"][0].copy())
            poses.append(run.hold(torque).to((k + 1) * step).pose)
        stuck = np.abs(np.diff(poses, axis=0)).max(axis=1) < 1e-5 * step
        assert 0.05 < stuck.mean() < 0.9  # both happen
        errors.append(np.abs(np.subtract(model, poses)).max())
    moved = np.abs(poses - robot.home_pose).max()
    assert moved > 0.005
    assert errors[0] < 0.002 * moved
    assert errors[1] < 0.6 * errors[0]


@pytest.mark.parametrize(
    ("plant", "line"),
    [
        ({"friction": {"coulomb": 0.1, "break_away": 0.05}}, "plant.friction.break_away: expected at least"),
        ({"friction": {}, "motor_friction": 0.1}, "plant.motor_friction: expected 0 where `friction`"),
        ({"friction": {"stribeck": 0.1}}, "plant.friction.stribeck: .*did you mean stribeck_velocity"),
    ],
)
def test_bad_friction_is_refused_in_a_line(plant, line):
    with pytest.raises(ConfigurationError, match=line):
        PlantOptions.from_dict(plant)
