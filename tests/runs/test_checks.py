import re

import numpy as np
import pytest

from stewart_drake import load_scenario
from stewart_drake.analysis.feasibility import check_reference
from stewart_drake.base.errors import ConfigurationError, InfeasibleReferenceError
from stewart_drake.mechanics.dynamics import static_torque
from stewart_drake.mechanics.kinematics import pose_jacobian
from stewart_drake.references import AdjustedReference, HeartbeatReference, MinimumJerkReference, SineReference
from stewart_drake.robot import RobotParameters
from stewart_drake.runs import checks
from stewart_drake.runs.checks import adjusted, check_scenario, fit_amplitude, fit_speed, plant_report
from stewart_drake.scenario.limits import ReferenceLimits
from stewart_drake.scenario.scenario import Scenario

ROBOT, LIMITS, GRAVITY = RobotParameters(), ReferenceLimits(), 9.81
WEAK = ROBOT.replace(effort_limit=0.45)
FAST = SineReference(angular_frequency=(14.0,) * 6)
BEATS = HeartbeatReference(excursion=(0.0, 0.0, 0.0, 0.004, 0.0, 0.01), rate=2.0, premature_beats=(2,))
REACH = MinimumJerkReference(
    poses=((0.0, 0.0, 0.0, 0.0, 0.0, 0.3), (0.2, 0.0, 0.0, 0.05, 0.0, 0.34)), durations=(0.15,)
)
TOO_FAR = SineReference(amplitude=(0.0, 0.0, 0.0, 0.3, 0.0, 0.0))


def feasible(robot, reference, duration):
    return check_reference(robot, LIMITS, reference, duration, GRAVITY).feasible


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "reference", "duration"), [(ROBOT, FAST, 1.0), (ROBOT, TOO_FAR, 4.0)])
def test_the_size_found_is_feasible_and_one_per_cent_more_is_not(robot, reference, duration):
    fitted, scale = fit_amplitude(robot, LIMITS, reference, duration, GRAVITY)
    assert 0.05 < scale < 1.0
    assert fitted == AdjustedReference(motion=reference, scale=scale)
    assert feasible(robot, fitted, duration)
    assert not feasible(robot, adjusted(reference, scale=1.01 * scale), duration)


@pytest.mark.slow
@pytest.mark.parametrize(("robot", "reference", "duration"), [(WEAK, BEATS, 2.0), (WEAK, REACH, 0.4)])
def test_the_speed_found_is_feasible_and_one_per_cent_more_is_not(robot, reference, duration):
    fitted, slowdown = fit_speed(robot, LIMITS, reference, duration, GRAVITY)
    assert 1.0 < slowdown < 20.0
    assert fitted == AdjustedReference(motion=reference, slowdown=slowdown)
    assert feasible(robot, fitted, slowdown * duration)
    faster = slowdown / 1.01
    assert not feasible(robot, adjusted(reference, slowdown=faster), faster * duration)
    # Every slower motion is feasible as well.
    for slower in (1.2 * slowdown, 3.0 * slowdown):
        assert feasible(robot, adjusted(reference, slowdown=slower), slower * duration)


def test_a_motion_bound_by_crank_speed_is_slowed_by_the_ratio_of_the_speeds():
    fastest = 10.0 - check_reference(ROBOT, LIMITS, FAST, 1.0, GRAVITY).smallest["crank_speed"].margin
    assert fit_speed(ROBOT, LIMITS, FAST, 1.0, GRAVITY)[1] == pytest.approx(fastest / 10.0, rel=5e-4)


BRIEF = MinimumJerkReference(poses=((0.0, 0.0, 0.0, 0.0, 0.0, 0.3), (0.0, 0.0, 0.0, 0.0, 0.0, 0.38)), durations=(0.02,))


@pytest.mark.parametrize("reference", [BRIEF, lambda time: BRIEF.evaluate(time)[0]], ids=["shipped", "own"])
def test_a_refusal_states_how_much_smaller_or_slower_a_brief_motion_can_be(reference):
    with pytest.raises(InfeasibleReferenceError, match="can be done at about") as caught:
        check_scenario(Scenario(reference=reference, duration=20.0))
    size, slowdown = map(float, re.search(r"([\d.]+) % .* ([\d.]+) times slower", str(caught.value)).groups())
    for more, expected in ((0.9, True), (1.1, False)):
        assert feasible(ROBOT, adjusted(BRIEF, scale=0.01 * size * more), 1.0) is expected
        assert feasible(ROBOT, adjusted(BRIEF, slowdown=slowdown / more), 1.0) is expected


class Slow:
    """A motion that says half of its own rate."""

    def evaluate(self, t):
        home, up = np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.3]), np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.01])
        return home + np.sin(t) * up, 0.5 * np.cos(t) * up, -np.sin(t) * up


def test_a_motion_whose_rates_do_not_fit_its_poses_is_named():
    with pytest.raises(ConfigurationError, match=r"rate is the derivative of its pose, there .* got 'z 0.005 m/s"):
        check_scenario(Scenario(reference=Slow(), duration=1.0))


def test_the_torque_of_the_plant_has_what_the_controller_does_not_know():
    assert plant_report(Scenario()).smallest == {}
    # At rest a payload in the middle is weight alone: of a heavier platform, or a force from outside.
    heavier = static_torque(ROBOT.replace(platform_mass=ROBOT.platform_mass + 2.0), ROBOT.home_pose)
    hold = Scenario(reference={"kind": "hold"}, duration=0.1)
    push = [{"kind": "constant", "wrench": [0, 0, 0, 0, 0, -2.0 * GRAVITY]}]
    for more in ({"plant.payload_mass": 2.0}, {"disturbances": push}):
        worst = plant_report(hold.replace(more)).smallest["plant_torque"]
        assert worst.value == pytest.approx(np.abs(heavier).max(), rel=1e-9)
        assert worst.margin == pytest.approx(5.0 - worst.value)
    # Friction holds a robot that stands, and is in the way of one that moves.
    rubbing = {"plant.friction": {"coulomb": 0.2, "break_away": 0.3, "viscous": 0.1}}
    assert plant_report(hold.replace(rubbing)).smallest["plant_torque"].value == pytest.approx(
        np.abs(static_torque(ROBOT, ROBOT.home_pose)).max()
    )
    believed = check_reference(ROBOT, LIMITS, FAST, 1.0).smallest["torque"].value
    worst = plant_report(Scenario(reference=FAST, duration=1.0).replace(rubbing)).smallest["plant_torque"]
    assert believed + 0.1 < worst.value < believed + 0.3 + 0.1 * 10.0
    assert worst.where == f"leg {worst.leg} with motor friction"


def test_a_base_that_heaves_counts_in_the_torque_of_the_motion_and_of_the_plant():
    """At the bottom of the heave a robot at rest on it has more weight, by the ratio of the accelerations."""
    heave = {"kind": "sine", "center": [0.0] * 6, "amplitude": [0, 0, 0, 0, 0, 0.1], "angular_frequency": [10.0] * 6}
    scenario = Scenario(reference={"kind": "hold"}, duration=1.0, base={"motion": heave})
    most = np.abs(static_torque(ROBOT, ROBOT.home_pose, GRAVITY + 0.1 * 10.0**2)).max()
    worst = checks.motion_report(scenario).smallest["torque"]
    assert worst.value == pytest.approx(most, rel=1e-3)
    loaded = plant_report(scenario.replace({"plant.payload_mass": 0.5})).smallest["plant_torque"]
    assert loaded.value > worst.value
    assert loaded.time == worst.time
    weak = scenario.replace({"robot.effort_limit": 0.99 * most})
    with pytest.raises(InfeasibleReferenceError):
        checks.check_scenario(weak)


def test_motors_as_sold_give_less_at_speed_than_the_robots_limit():
    """By hand: the line from the torque at rest to the speed without load."""
    servo = {"kind": "position", "torque_limit": 2.0, "no_load_speed": 8.0, "damping": 0.0}
    scenario = load_scenario("sway", ["robot=servo_hexapod", "safety=null", "controller={kind: feedforward}"])
    worst = plant_report(scenario.replace({"motors": servo})).smallest["plant_torque"]
    pose, rate, _ = scenario.reference.evaluate(worst.time)
    speed = abs((pose_jacobian(scenario.robot, pose) @ rate)[worst.leg])
    assert worst.bound == pytest.approx(min(scenario.robot.effort_limit, 2.0) * (1.0 - speed / 8.0))
    weak = {**servo, "torque_limit": 0.001}
    assert plant_report(scenario.replace({"motors": weak})).first_violation is not None


def test_motions_that_have_passed_are_remembered_and_not_for_ever(monkeypatch):
    monkeypatch.setattr(checks, "_MAX_PASSED", 3)
    monkeypatch.setattr(checks, "_PASSED", set())
    for duration in (0.1, 0.2, 0.3, 0.4, 0.4):
        checks.check_scenario(Scenario(reference="hold", duration=duration))
        assert 1 <= len(checks._PASSED) <= 3
