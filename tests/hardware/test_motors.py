import numpy as np
import pytest

from stewart_drake.hardware.faults import CommandFault, MotorFault
from stewart_drake.hardware.motors import DeadMotor, LinkOptions, TorqueMotors

WANTED = np.array([0.123, -0.456, 1.0, 4.9, -4.9, 0.0])
ANGLES = np.linspace(-1.0, 1.0, 6)


def test_steps_ripple_and_a_dead_motor():
    torque = TorqueMotors(resolution=0.05).torque(WANTED, ANGLES, np.zeros(6), 0.0)
    np.testing.assert_allclose(torque / 0.05, np.rint(torque / 0.05), atol=1e-9)
    assert np.abs(torque - WANTED).max() <= 0.025
    motor = TorqueMotors(ripple=0.02, ripple_periods=12, dead=DeadMotor(leg=3, time=0.5))
    alive, dead = motor.torque(WANTED, ANGLES, np.zeros(6), 0.4999), motor.torque(WANTED, ANGLES, np.zeros(6), 0.5)
    np.testing.assert_allclose(alive - WANTED, 0.02 * np.sin(12 * ANGLES), atol=1e-12)
    np.testing.assert_array_equal(dead, np.where(np.arange(6) == 3, 0.0, alive))


def test_motors_wired_wrong_give_the_torques_asked_for_elsewhere_or_with_the_other_sign():
    faults = (MotorFault(kind="reversed", leg=3, time=0.5), MotorFault(kind="swapped", leg=3, other=1, time=0.6))
    motor = TorqueMotors(faults=faults)
    signs = np.array([1.0, 1.0, 1.0, -1.0, 1.0, 1.0])
    np.testing.assert_array_equal(motor.torque(WANTED, ANGLES, np.zeros(6), 0.4999), WANTED)
    np.testing.assert_array_equal(motor.torque(WANTED, ANGLES, np.zeros(6), 0.5), signs * WANTED)
    np.testing.assert_array_equal(motor.torque(WANTED, ANGLES, np.zeros(6), 0.6), (signs * WANTED)[[0, 3, 2, 1, 4, 5]])


STEPS = 4


def arrivals(options, ticks=8, steps=STEPS):
    """Command in force and its age at every step; tick k sends k + 1 to all motors, and says so until the next."""
    part = options.part(0.001 * steps, 0.001, np.zeros(6))
    state, said = part.initial.copy(), []
    for step in range(ticks * steps):
        part.tick(np.full(6, step // steps + 1.0), np.array([0.001 * step]), state)
        assert np.ptp(state["torque"]) == 0.0
        said.append((state["torque"][0, 0], state["age"][0, 0]))
    return np.array(said).reshape(ticks, steps, 2)


def test_a_dropped_tick_leaves_the_last_command_and_its_age_grows():
    told = arrivals(LinkOptions(dropped=(2, 3, 6)))
    np.testing.assert_array_equal(told[:, 0, 0], [1, 2, 2, 2, 5, 6, 6, 8])
    np.testing.assert_array_equal(told[:, 0, 1], [0, 0, 1, 2, 0, 0, 1, 0])
    np.testing.assert_array_equal(arrivals(LinkOptions(stop_time=0.012))[:, 0, 0], [1, 2, 3, 3, 3, 3, 3, 3])


def test_a_late_command_acts_a_step_later():
    told = arrivals(LinkOptions(late_probability=1.0))
    np.testing.assert_array_equal(told[2], [[2.0, 1.0]] + [[3.0, 0.0]] * 3)


def test_chance_drops_its_share_by_the_seed_alone_and_by_the_tick():
    options, again, other = (LinkOptions(drop_probability=0.2, late_probability=0.3, seed=seed) for seed in (4, 4, 5))
    fates = [options.fate(tick, 0.0) for tick in range(20_000)]
    assert abs(fates.count("dropped") / 20_000 - 0.2) < 0.01
    assert abs(fates.count("late") / 20_000 - 0.8 * 0.3) < 0.01
    assert [again.fate(tick, 0.0) for tick in (19_999, 3, 1024)] == [fates[19_999], fates[3], fates[1024]]
    assert [other.fate(tick, 0.0) for tick in range(100)] != fates[:100]


@pytest.mark.parametrize(
    ("fault", "expected"),
    [
        (CommandFault(kind="nan", leg=2), [0, 1, np.nan, 3, 4, 5]),
        (CommandFault(kind="offset", leg=0, size=-3.0), [-3, 1, 2, 3, 4, 5]),
        (CommandFault(kind="chatter", leg=1, size=2.0), [0, -1, 2, 3, 4, 5]),
        (CommandFault(kind="nan", time=0.2), [0, 1, 2, 3, 4, 5]),
        (CommandFault(kind="nan", duration=0.1), [0, 1, 2, 3, 4, 5]),
    ],
)
def test_command_faults_change_what_arrives_and_not_the_array_of_the_controller(fault, expected):
    part = LinkOptions(faults=(fault,)).part(0.001, 0.001, np.zeros(6))
    command, time = np.arange(6.0), np.array([0.1])
    state = part.initial.copy()
    for _ in range(8):
        part.tick(command, time, state)
    np.testing.assert_array_equal(state["torque"][0], expected)
    np.testing.assert_array_equal(command, np.arange(6.0))
