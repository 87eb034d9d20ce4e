"""The law of the rolling ball against Newton and Euler's equations, a turntable, and the robot's energy."""

import numpy as np
from scipy.spatial.transform import Rotation

from stewart_drake.mechanics.ball import BallOptions
from stewart_drake.mechanics.dynamics_laws import task_inertia
from stewart_drake.mechanics.kinematics import rotation_matrix
from stewart_drake.mechanics.kinematics_laws import Legs, legs_at, robot_record, twist_of
from stewart_drake.mechanics.rolling_ball import SLOW, ball_rate, ball_terms
from stewart_drake.plant.closed_form import ClosedFormOptions
from stewart_drake.robot import RobotParameters, base_reading

BALL = BallOptions(mass=0.3, radius=0.02, resistance=0.05, plate={"height": 0.04}, hollow=True)
GRAVITY = np.array([0.0, 0.0, -9.81])


def rates(ball, turn, twist, twist_rate, motion, push=(0.0, 0.0)):
    """Rate of the ball's motion, and its terms."""
    terms, rate, numbers = np.empty((8, 7)), np.empty(5), ball.record()
    numbers["push"] = push
    ball_terms(numbers[0], turn, twist, base_reading(9.81), motion, terms)
    ball_rate(numbers[0], turn, twist, twist_rate, terms, motion, rate)
    return rate, terms


def velocities(ball, turn, twist, motion):
    """Velocity of the centre, and the angular velocity by the rolling condition: no slip, and the spin."""
    normal, slide = turn[:, 2], turn[:, :2] @ motion[2:4]
    place = turn @ [*motion[:2], ball.plate.height + ball.radius]
    centre = twist[3:] + np.cross(twist[:3], place) + slide
    plate = twist[3:] + np.cross(twist[:3], place - ball.radius * normal)
    across = np.array([[0, -normal[2], normal[1]], [normal[2], 0, -normal[0]], [-normal[1], normal[0], 0]])
    # centre - r omega x n = plate, and omega . n = spin.
    matrix = np.vstack([ball.radius * across, normal])
    spin = np.linalg.lstsq(matrix, np.append(plate - centre, motion[4]), rcond=None)[0]
    return centre, spin, place


def test_newton_and_euler():
    """Forces and moments on the ball, and its reaction on the platform, at a random instant of a random motion."""
    rng = np.random.default_rng(3)
    for _ in range(20):
        turn = Rotation.random(random_state=rng).as_matrix()
        turn = turn if turn[2, 2] > 0.0 else turn @ np.diag([1.0, -1.0, -1.0])
        twist, twist_rate = rng.normal(size=6), 3.0 * rng.normal(size=6)
        motion, push = np.append(0.1 * rng.normal(size=4), 5.0 * rng.normal()), rng.normal(size=2)
        rate, terms = rates(BALL, turn, twist, twist_rate, motion, push)

        def later(time, turn=turn, twist=twist, twist_rate=twist_rate, motion=motion, rate=rate):
            step = Rotation.from_rotvec(time * twist[:3] + 0.5 * time**2 * twist_rate[:3]).as_matrix()
            return velocities(BALL, step @ turn, twist + time * twist_rate, motion + time * rate)

        (after, spin_after, _), (before, spin_before, _), h = later(1e-5), later(-1e-5), 2e-5
        _, _, place = later(0.0)
        normal, slide = turn[:, 2], turn[:, :2] @ motion[2:4]
        force = BALL.mass * ((after - before) / h - GRAVITY) - turn[:, :2] @ push
        weight = max(0.0, -BALL.mass * GRAVITY @ normal)
        drag = BALL.resistance * weight / np.hypot(np.linalg.norm(slide), SLOW)
        couple = -drag * BALL.radius * np.cross(normal, slide)
        moment = -BALL.radius * np.cross(normal, force) + couple
        np.testing.assert_allclose(BALL.inertia * (spin_after - spin_before) / h, moment, atol=2e-7)
        contact = place - BALL.radius * normal
        load = np.concatenate([np.cross(contact, force) + couple, force])
        np.testing.assert_allclose(terms[:6, :6] @ twist_rate + terms[:6, 6], load, atol=1e-6)
        assert np.linalg.norm(load) > 0.1


def test_a_turntable_turns_the_path_by_two_sevenths():
    """A solid ball on a turntable goes in circles at 2/7 of its rate, seen from outside."""
    ball, omega, h, steps = BallOptions(resistance=0.0), 3.0, 1e-3, 2000
    motion, twist = np.array([0.05, 0.0, 0.1, -0.1, 2.0]), np.array([0.0, 0.0, omega, 0.0, 0.0, 0.0])
    paths = []
    for n in range(steps):

        def rate(at, time):
            return rates(ball, Rotation.from_euler("z", omega * time).as_matrix(), twist, np.zeros(6), at)[0]

        paths.append(Rotation.from_euler("z", omega * n * h).as_matrix()[:2, :2] @ motion[:2])
        k1 = rate(motion, n * h)
        k2 = rate(motion + 0.5 * h * k1, (n + 0.5) * h)
        motion = motion + h * k2
    velocity = np.diff(paths, axis=0) / h
    angle = np.unwrap(np.arctan2(velocity[:, 1], velocity[:, 0]))
    np.testing.assert_allclose(np.diff(angle) / h, 2.0 / 7.0 * omega, rtol=1e-4)
    np.testing.assert_allclose(np.linalg.norm(velocity, axis=1), np.linalg.norm(velocity[0]), rtol=1e-4)


def energy(robot, ball, measured, spin):
    """[J] of robot and ball."""
    pose, rate, (x, y, *slide) = measured[:6], measured[6:12], measured[24:28]
    numbers, legs, inertia, twist = robot_record(robot), Legs.empty(), np.empty((6, 6)), np.empty(6)
    assert legs_at(numbers[0], pose, legs[0]) < 0
    task_inertia(numbers[0], legs[0], inertia)
    twist_of(pose, rate, twist)
    turn, one, part = rotation_matrix(pose[:3]), numbers.view(np.recarray)[0], legs.view(np.recarray)[0]
    centre, omega, place = velocities(ball, turn, twist, np.array([x, y, *slide, spin]))
    height = one.platform_mass * pose[5] + (turn @ one.platform_moment)[2] + ball.mass * (pose[5] + place[2])
    for i in range(6):
        tip = one.shaft[i, 2] + one.crank_length[i] * part.crank[i, 2]
        height += one.crank_mass * 0.5 * (one.shaft[i, 2] + tip)
        height += one.rod_mass * (tip + 0.5 * one.rod_length[i] * part.e_l[i, 2])
    moving = 0.5 * (twist @ inertia @ twist + ball.mass * centre @ centre + ball.inertia * omega @ omega)
    return moving + 9.81 * height


def test_energy_of_robot_and_ball():
    """Without friction and torques the sum of all energies stays, while the robot falls with the ball."""
    robot = RobotParameters()
    ball = BallOptions(mass=0.5, radius=0.03, resistance=0.0, start=(0.08, -0.05), velocity=(0.4, 0.3))
    plant = ClosedFormOptions(integrator="rk4", time_step=0.0005).make(robot, 9.81, ball)
    measured = plant.initial(robot.home_pose, np.array([0.8, -0.5, 0.6, 0.1, -0.1, 0.2])).copy()
    first, none = energy(robot, ball, measured, 0.0), np.zeros(6)
    for _ in range(200):
        measured = plant.step(none, none)
        assert abs(energy(robot, ball, measured, measured[28]) - first) < 2e-8 * abs(first)
    given = 9.81 * ball.mass * (robot.home_pose[5] - measured[5])
    assert given > 0.1, "The ball has given energy to the robot."
