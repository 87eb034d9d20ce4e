import numpy as np
import pytest
from plant_runs import Run
from strategies import ROBOT, UNEQUAL

from stewart_drake.errors import ConfigurationError
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.plant.closed_chain import ClosedChain
from stewart_drake.plant.plant_options import PlantOptions
from stewart_drake.robot.friction_options import FrictionOptions
from stewart_drake.robot.robot_files import load_robot

HOME = ROBOT.home_pose
SIGNS = np.array([1.0, -1.0, 1.0, 1.0, -1.0, 1.0])
SMALL = load_robot("reachy_mini")


def test_friction_hides_its_actuators():
    stewart = Run(motor_friction=0.1).stewart
    assert stewart.plant.num_actuators() == 12
    assert stewart.torque_input_port.size() == 6


def test_the_rotors_keep_their_inertia_beside_friction():
    """Drake takes the rotor of a joint from one of its actuators."""
    masses = []
    for options in ({}, {"motor_friction": 0.1}, {"friction": FrictionOptions(coulomb=(0.1, 0.0) * 3)}):
        plant = Run(robot=UNEQUAL, **options).stewart.plant
        masses.append(plant.CalcMassMatrix(plant.CreateDefaultContext()))
    for other in masses[1:]:
        np.testing.assert_allclose(other, masses[0], rtol=1e-12, atol=1e-15)


@pytest.mark.parametrize("ratio", [0.5, 0.9, 0.98])
@pytest.mark.parametrize("share", [1.0, 0.5], ids=["coulomb", "stribeck"])
@pytest.mark.parametrize(
    ("robot", "break_away", "viscous"),
    [(ROBOT, 0.05, 0.0), (ROBOT, 0.5, 0.0), (ROBOT, 0.01, 0.02), (UNEQUAL, 0.3, 0.0), (SMALL, 0.058, 0.095)],
    ids=["paper", "strong", "weak", "unequal", "small"],
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


def test_between_the_levels_what_rests_stays_and_what_slides_goes_on():
    options = {"gravity": 0.0, "friction": FrictionOptions(coulomb=0.05, break_away=0.1, stribeck_velocity=0.02)}
    torque = np.full(6, 0.07)
    rests = Run(**options).hold(torque).to(0.3)
    assert np.abs(rests.pose - HOME).max() < 1e-5
    slides = Run(**options).hold(np.full(6, 0.15)).to(0.05).hold(torque).to(0.1)
    speed = slides.rates.copy()
    assert (slides.to(0.15).rates > speed + 0.01).all()
    # Stopped, it takes break-away again.
    stopped = slides.hold(np.full(6, -0.3)).to(0.2).hold(np.zeros(6)).to(0.6)
    at = stopped.pose
    assert np.abs(stopped.hold(torque).to(0.8).pose - at).max() < 1e-5


def test_each_motor_has_its_own_friction():
    own = FrictionOptions(coulomb=(0.0, 0.1, 0.2, 0.3, 0.4, 0.0), viscous=(0.0, 0.0, 0.0, 0.0, 0.0, 0.01))
    slowed = Run(gravity=0.0, friction=own).hold([0.5] * 6).to(0.05)
    free = Run(gravity=0.0, friction=FrictionOptions(viscous=own.viscous)).hold(0.5 - np.array(own.coulomb)).to(0.05)
    assert np.abs(free.pose - HOME).max() > 1e-3
    np.testing.assert_allclose(slowed.pose, free.pose, atol=1e-6)


def test_friction_takes_its_energy_from_a_moving_robot_along_the_stribeck_curve():
    said = FrictionOptions(coulomb=0.02, break_away=0.05, stribeck_velocity=4.0, viscous=0.003)
    run = Run(rate=[0.5, -0.3, 1.0, 0.1, 0.1, 0.05], gravity=0.0, time_step=1e-4, friction=said)

    def power():
        speed = np.abs(run.rates)
        return np.sum((0.02 + 0.03 * np.exp(-((speed / 4.0) ** 2)) + 0.003 * speed) * speed)

    before, powers = run.kinetic_energy, [power()]
    for step in range(1, 151):
        run.to(step * 1e-4)
        powers.append(power())
    lost, dissipated = before - run.kinetic_energy, 1e-4 * (np.sum(powers) - 0.5 * (powers[0] + powers[-1]))
    assert lost > 1e-3
    assert lost == pytest.approx(dissipated, rel=0.01)


def test_anchors_live_in_the_context():
    one, other = (Run(motor_friction=0.05) for _ in range(2))
    assert one.diagram is other.diagram
    one.hold(static_torque(ROBOT, HOME) + 0.2).to(0.05)
    other.hold(static_torque(ROBOT, HOME) + 0.04).to(0.05)
    assert np.abs(one.pose - HOME).max() > 1e-3
    assert np.abs(other.pose - HOME).max() < 1e-6


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


def test_short_keys_and_the_section_say_the_same():
    short = PlantOptions(motor_friction=0.05, motor_damping=0.01).friction_law(ROBOT)
    long = PlantOptions(friction=FrictionOptions(coulomb=0.05, viscous=(0.01,) * 6)).friction_law(ROBOT)
    np.testing.assert_array_equal(short, long)
    np.testing.assert_array_equal(short["break_away"], short["coulomb"])


@pytest.mark.parametrize(
    ("plant", "line"),
    [
        ({"friction": {"coulomb": 0.1, "break_away": 0.05}}, "plant.friction.break_away: expected at least"),
        ({"friction": {"coulomb": -0.1}}, "plant.friction.coulomb: expected a number from 0 to 1e"),
        ({"friction": {"coulomb": [0.1, 0.1]}}, r"plant.friction.coulomb: expected .*a list of 6"),
        ({"friction": {}, "motor_friction": 0.1}, "plant.motor_friction: expected 0 where `friction`"),
        ({"friction": {"stribeck": 0.1}}, "plant.friction.stribeck: .*did you mean stribeck_velocity"),
    ],
)
def test_bad_friction_is_refused_in_a_line(plant, line):
    with pytest.raises(ConfigurationError, match=line):
        PlantOptions.from_dict(plant)
