"""`drive`: a controller on a machine, here one in the same process whose servos come to their angles by a lag."""

import re

import numpy as np
import pytest
from lagging_servos import HOME, Servos

from stewart_drake import ConfigurationError, inverse_kinematics, load_log, load_scenario, run_metrics
from stewart_drake.base.errors import InfeasibleReferenceError, RunFailure
from stewart_drake.machines.machine import MachineError, Reading
from stewart_drake.machines.simulated import SimulatedRobot
from stewart_drake.references.paced import RAMP
from stewart_drake.runs.drive import APPROACH_SPEED, HOLD_TIME, Drive, connected
from stewart_drake.runs.replay import write_replay

SERVOS = {
    "motors": {"kind": "position", "preset": "xl330_m288"},
    "controller": {"kind": "feedforward", "feedforward": "none", "period": 0.02},
    **{"estimator": "difference", "tuner": "fixed", "safety": None, "duration": 2.0},
    "model": {"friction": None, "motors": {"kind": "position", "preset": "xl330_m288", "damping": 0.0}},
}
BASE = load_scenario("reachy_nod").replace(SERVOS)
HOME_POSE, FAR = BASE.robot.home_pose.tolist(), (BASE.robot.home_pose + [0.0, 0.0, 0.0, 0.0, 0.0, 0.1]).tolist()
ROTATED = BASE.robot.home_pose + [0.1, -0.05, 0.1, 0.0, 0.0, 0.003]


class Exact:
    """A paced machine at 1 kHz: the plant of a scenario, which loses a tick now and then."""

    period, takes, reads, paced = 0.001, "torque", True, True

    def __init__(self, scenario, lost):
        self.robot, self.lost, self.count, self.commands = SimulatedRobot(scenario), lost, 0, []

    def connect(self):
        pass

    def read(self):
        for _ in range(2 if self.lost and self.count % self.lost == self.lost - 1 else 1):
            angles = self.robot.reading().copy()
            self.robot.advance(not self.commands)
            self.count += 1
        return Reading(angles, 0.001 * self.count, 0.0, self.count)

    def command(self, values):
        self.commands.append(values.copy())
        self.robot.command[:] = values

    def disconnect(self):
        pass


def driven(machine, scenario=BASE, seconds=None):
    return Drive(scenario, machine, connected(scenario, machine, seconds)).run()


def test_it_approaches_the_motion_from_the_pose_of_the_robot_and_rests_at_its_end():
    machine = Servos(inverse_kinematics(BASE.robot, ROTATED))
    start = connected(BASE, machine)
    np.testing.assert_allclose(start.pose, ROTATED, atol=1e-6)
    log = Drive(BASE, machine, start).run()
    assert (log.status, machine.gone) == ("completed", True)
    np.testing.assert_allclose(log["reference"][0], ROTATED, atol=1e-6)
    assert log.end_time == pytest.approx(start.motion.approach + 2.0 + RAMP + HOLD_TIME, abs=0.05)
    np.testing.assert_allclose(log["reference"][-1], BASE.reference.evaluate(2.0)[0], atol=1e-9)
    speeds = np.diff(machine.commands, axis=0) / 0.02
    assert np.abs(speeds[: int(start.motion.approach / 0.02)]).max() < 0.7
    assert np.abs(speeds[-5:]).max() < 0.1
    assert run_metrics(log)["rmse_norm_deg"] < 3.0
    np.testing.assert_array_equal(log["commanded_angle"], machine.commands)


def test_its_log_is_that_of_a_run(tmp_path):
    log = driven(Servos(), seconds=1.0)
    log.save(tmp_path / "log.parquet")
    again = load_log(tmp_path / "log.parquet")
    assert set(again) == set(log)
    assert {"lateness", "reading_age", "commanded_angle", "pose", "reference", "reading"} <= set(log)
    assert "torque_rms" in run_metrics(log)


def test_what_a_machine_without_encoders_has_done_is_not_known_and_marked(tmp_path):
    machine = Servos()
    machine.reads = False
    machine.read = lambda: Reading((machine.commands or [HOME])[-1].copy(), 0.02 * len(machine.commands), 0.0, 0)
    machine.paced = False
    log = driven(machine, seconds=0.5)
    assert (log.status, [each["name"] for each in log.warnings]) == ("completed", ["not_measured"])
    assert np.isnan(log["reading"]).all()
    assert "crank_angle" not in log
    metrics = run_metrics(log)
    assert {metrics[name] for name in ("rmse_norm_deg", "peak_norm_mm", "pose_rmse_mm", "motion_ratio")} == {None}
    assert np.isnan(log.error).all()
    write_replay([log, log], tmp_path / "replay.html", ["runs/a", "runs/b"])
    page = (tmp_path / "replay.html").read_text("utf-8")
    assert "the machine does not tell its angles" in page
    assert re.search(r"<title>.*runs/a, runs/b", page)
    assert re.search(r'"rotation_deg": \[null, ', page)
    log.save(tmp_path / "log.parquet")
    assert load_log(tmp_path / "log.parquet").warnings == log.warnings


INERTIAL = {"estimator": "observer", "model.imu": {}, "sensors": {"kind": "encoders", "imu": {}}}


@pytest.mark.parametrize(("known", "told"), [({}, 1), (INERTIAL, 0)])
def test_an_inertial_sensor_is_used_and_logged_and_told_where_the_controller_does_not_know_it(known, told, caplog):
    machine, scenario = Servos(), BASE.replace(known)
    plain = machine.read
    machine.read = lambda: plain()._replace(imu=np.array([0.0, 0.0, 0.0, 0.0, 0.0, 9.81]))
    log = driven(machine, scenario, seconds=0.5)
    assert log.status == "completed"
    assert sum("inertial sensor" in record.message for record in caplog.records) == told
    assert ("imu" in log) == bool(known)
    if known:
        assert log["imu"][-1].tolist() == [0.0, 0.0, 0.0, 0.0, 0.0, 9.81]


def test_a_sensor_that_the_controller_expects_and_the_machine_lacks_is_a_warning():
    log = driven(Servos(), BASE.replace(INERTIAL), seconds=0.5)
    (warning,) = (each for each in log.warnings if each["name"] == "imu_silent")
    assert warning["text"].startswith("the inertial sensor gave no readings for")
    assert log.status == "completed"


def interrupted(_):
    raise KeyboardInterrupt


def lost(_):
    raise MachineError("robot", "lost")


def late(machine):
    machine.age = 0.6


def off(machine):
    machine.holding = True


def silent(machine):
    machine.event, machine.at = (lambda _: None), None
    machine.read = lambda: Reading(machine.angles.copy(), 0.0, 0.9, machine.count)


def slow_to_let_go(machine):
    def disconnect():
        machine.gone = True
        raise KeyboardInterrupt

    machine.disconnect = disconnect
    raise KeyboardInterrupt


def broken(_):
    raise ZeroDivisionError("odd")


@pytest.mark.parametrize(
    ("event", "status", "reason", "rests"),
    [
        (interrupted, "interrupted", "interrupted", True),
        (late, "failed", "stale_reading", True),
        (slow_to_let_go, "interrupted", "interrupted", True),
        (off, "failed", "holding", True),
        (silent, "failed", "stale_reading", False),
        (lost, "failed", "machine", False),
        (broken, "failed", "run_failure", False),
    ],
)
def test_what_goes_wrong_slows_it_down_on_its_path_and_is_told(event, status, reason, rests):
    machine = Servos(at=130, event=event)
    log = driven(machine, BASE.replace({"duration": 10.0}))
    assert (log.status, log.reason, machine.gone) == (status, reason, True)
    assert log.end_time < 130 * 0.02 + RAMP + HOLD_TIME + 0.7
    moved = np.abs(np.diff(machine.commands, axis=0)).max(axis=1)
    assert moved.max() < 0.12
    assert bool(moved[-5:].max() < 0.01) == rests


@pytest.mark.parametrize("also", [False, True])
def test_a_robot_that_is_far_from_its_path_is_held_where_it_is_also_while_it_stops(also):
    def stuck(machine):
        machine.command = lambda values: machine.commands.append(values.copy())
        machine.angles = HOME + 0.5
        if also:
            raise KeyboardInterrupt

    machine = Servos(at=130, event=stuck)
    start = connected(BASE.replace({"duration": 10.0}), machine)
    before, drive = len(machine.commands), Drive(BASE.replace({"duration": 10.0}), machine, start)
    log = drive.run()
    assert log.reason == ("interrupted" if also else "not_following")
    assert "held where it stood" in drive.ending
    # The guard looks before a command goes out: none is sent along the path any more.
    went_on = [command for command in machine.commands[before:] if np.abs(command - HOME).max() > 0.45]
    np.testing.assert_array_equal(went_on, np.tile(HOME + 0.5, (len(went_on), 1)))
    assert len(machine.commands) - len(went_on) <= 130
    assert len(went_on) > 50


@pytest.mark.parametrize("off", [2.0 * np.pi, -1.0])
def test_one_reading_that_is_wrong_is_not_where_the_robot_is_sent(off):
    def wrong(machine):
        read, bad = machine.read, machine.count

        def other():
            reading = read()
            reading.angles[2] += off if machine.count == bad + 1 else 0.0
            return reading

        machine.read = other

    machine = Servos(at=130, event=wrong)
    log = driven(machine)
    assert log.reason != "not_following"
    assert np.abs(np.diff(machine.commands, axis=0)).max() < 0.12


def test_a_robot_that_torques_move_is_held_at_the_pose_that_is_measured():
    scenario = load_scenario("exact_fig7", ["plant.kind=closed_form", "sensors=encoders", "duration=1", "safety=null"])
    scenario = scenario.replace({"bounds.crank_angle": 0.02})
    push = {"kind": "step", "time": 1.0, "wrench": [0.0, 0.0, 0.0, 0.0, 0.0, -90.0], "until": 1.06}
    log = driven(Exact(scenario.replace({"disturbances": [push]}), 0), scenario)
    assert log.reason == "not_following"
    last = log["reference"][-1]
    np.testing.assert_allclose(log["reference"][-1200:], np.tile(last, (1200, 1)))
    np.testing.assert_allclose(log["pose"][-1], last, atol=1e-3)
    at = int(np.abs(log["reference"] - last).max(axis=1).argmin())
    np.testing.assert_allclose(log["pose"][at - 1], last, atol=1e-3)


def test_the_approach_begins_at_the_pose_of_the_first_command():
    machine = Servos()
    start = connected(BASE, machine)
    drive = Drive(BASE, machine, start)
    begun = inverse_kinematics(BASE.robot, ROTATED)
    machine.angles = begun.copy()
    log = drive.run()
    assert log.status == "completed"
    assert log.scenario.duration == pytest.approx(start.motion.approach + 2.0 + RAMP)
    speeds = np.abs(np.diff([begun, *machine.commands], axis=0)).max(axis=1) / 0.02
    assert speeds[: int(start.motion.approach / 0.02)].max() < 0.7


def test_a_robot_that_is_still_moved_by_hand_is_not_driven():
    machine = Servos()
    drive = Drive(BASE, machine, connected(BASE, machine))
    read = machine.read
    shift = np.zeros(6)

    def shaken():
        shift[:] = 0.05 - shift
        return read()._replace(angles=HOME + shift)

    machine.read = shaken
    with pytest.raises(RunFailure, match="hold it still"):
        drive.run()
    assert machine.commands == []


class Lossy(Servos):
    """Servos at the end of a line that loses packets, commands and readings; readings say which command arrived."""

    def __init__(self, share):
        super().__init__()
        self.share, self.random, self.followed = share, np.random.default_rng(1), [HOME]

    def read(self):
        while True:
            self.angles += 0.6 * (self.followed[-1] - self.angles)
            reading = super().read()
            if self.random.random() >= self.share:
                return reading._replace(arrived=self.followed[-1].copy())

    def command(self, values):
        if self.random.random() >= self.share:
            self.followed.append(values.copy())


def test_on_a_line_that_loses_packets_commands_are_near_to_the_last_that_has_arrived():
    farthest = {}
    for share in (0.0, 0.5):
        machine = Lossy(share)
        driven(machine, BASE.replace({"bounds.crank_angle": None, "duration": 4.0}))
        farthest[share] = np.abs(np.diff(machine.followed, axis=0)).max()
    # As far as the path goes in three ticks, and half a radian a second besides.
    assert farthest[0.5] < 3.0 * farthest[0.0] + APPROACH_SPEED * 0.06


def test_commands_that_lead_the_path_so_that_servos_give_their_torque_are_sent_as_they_are():
    soft = {"kind": "position", "preset": "xl330_m288", "stiffness": 0.2, "damping": 0.0}
    scenario = BASE.replace({"controller.feedforward": "full", "model.motors": soft, "bounds.crank_angle": 0.1})
    scenario = scenario.replace({"reference.motion.angular_frequency": 15.0})

    class Follower(Servos):
        def read(self):
            self.angles = inverse_kinematics(scenario.robot, start.motion.evaluate(0.02 * max(self.count - 2, 0))[0])
            return super().read()

    start = connected(scenario, machine := Servos())
    machine.__class__ = Follower
    log = Drive(scenario, machine, start).run()
    wanted, path = log["commanded_angle"], [inverse_kinematics(scenario.robot, pose) for pose in log["reference"]]
    assert np.abs(wanted - path).max() > 0.3
    settled = log["time"] > 1.0
    np.testing.assert_allclose(np.array(machine.commands)[settled], wanted[settled], atol=1e-12)


def test_a_second_interrupt_does_not_wait():
    def again(machine):
        machine.at += 5
        raise KeyboardInterrupt

    machine = Servos(at=80, event=again)
    log = driven(machine, BASE.replace({"duration": 10.0}))
    assert log.status == "interrupted"
    assert machine.gone
    assert machine.count == 85


@pytest.mark.parametrize(
    ("change", "words"),
    [
        ({"angles": HOME + [1.5, 0, 0, 0, 0, 0]}, "angle of leg 0.*its stops"),
        ({"takes": "torque"}, "model.motors.*motors that take torque, as the machine does"),
        ({"period": 0.01}, "controller.period.*about 0.01 s, that of the machine"),
        ({"angles": HOME + 0.5}, "angles.*can stand at.*leg order"),
    ],
)
def test_what_does_not_fit_is_refused_before_anything_moves(change, words):
    machine = Servos()
    for name, value in change.items():
        setattr(machine, name, value)
    with pytest.raises(ConfigurationError, match=words):
        connected(BASE, machine)
    assert machine.commands == []


def test_adaptation_is_refused_for_a_machine_without_angles():
    machine = Servos()
    machine.reads = False
    with pytest.raises(ConfigurationError, match=r"adaptation.*does not tell its angles"):
        connected(BASE.replace({"adaptation": "regression"}), machine)
    for nothing_learns in (None, {"kind": "regression", "frozen": True}):
        connected(BASE.replace({"adaptation": nothing_learns}), machine)


def test_a_motion_that_leaves_the_limits_later_is_refused():
    scenario = BASE.replace({"reference": {"kind": "spline", "times": [0, 2, 4], "poses": [HOME_POSE, HOME_POSE, FAR]}})
    connected(scenario, Servos(), 1.0)
    with pytest.raises(InfeasibleReferenceError):
        connected(scenario, Servos(), 4.0)


def test_lost_ticks_are_ticks_without_a_reading_and_no_velocity():
    """By torque: a machine of the exact plant in which one tick of 50 is lost."""
    scenario = load_scenario("exact_fig7", ["plant.kind=closed_form", "sensors=encoders", "duration=1"])
    steps = {}
    for lost in (0, 50):
        machine = Exact(scenario, lost)
        assert driven(machine, scenario).status == "completed"
        steps[lost] = np.abs(np.diff(machine.commands, axis=0)).max()
    assert steps[50] < 3.0 * steps[0]


def test_motors_that_never_move_are_found_before_the_error_is_large():
    machine = Servos()
    machine.command = machine.commands.append
    log = driven(machine, BASE.replace({"duration": 10.0}))
    assert (log.status, log.reason) == ("failed", "reading_stuck")
    assert "all six readings repeat themselves" in log.message
    assert log.end_time < 4.0


def dead(leg):
    def event(machine):
        held, command = machine.angles[leg].copy(), machine.command

        def without(values):
            command(values)
            machine.angles[leg] = held

        machine.command = without

    return event


@pytest.mark.parametrize(("leg", "at"), [(0, 2), (1, 2), (1, 250), (4, 250)])
def test_a_dead_motor_stops_the_drive_within_two_seconds(leg, at):
    """10 deg at 0.5 Hz; of the legs that move least, and after it has moved for long."""
    nod = {"kind": "sine", "amplitude": [0, 0.1745, 0, 0, 0, 0], "angular_frequency": 3.1416}
    machine = Servos(at=at, event=dead(leg))
    log = driven(machine, BASE.replace({"duration": 12.0, "reference": nod}))
    assert (log.status, log.reason, log.leg) == ("failed", "not_moving", leg)
    # Nor is the robot sent to the reading that stands still, all at once.
    assert np.abs(np.diff(machine.commands, axis=0)).max() < 0.06
    # The approach does not move here, and the motion begins slowly.
    assert log.outcome_time < max(0.02 * at, 1.5) + 2.0


class Ticking(Servos):
    """Its clock is of its own: readings at some times, counted by some numbers."""

    def __init__(self, tick, counts=1):
        super().__init__()
        self.now, self.tick, self.counts, self.number = 0.0, tick, counts, 0
        self.period = tick(0.0)

    def read(self):
        super().read()
        self.now += self.tick(self.now)
        self.number += self.counts if self.now > 4.0 else 1
        return Reading(self.angles.copy(), self.now, 0.0, self.number)


def motion_frequency(machine, log):
    """[Hz] by the machine's clock of a sine that is wanted, from its extremes."""
    wanted = log["reference"][:, 1]
    extremes = np.flatnonzero(np.diff(np.sign(np.diff(wanted)))) + 1
    at = np.interp(extremes, np.arange(len(wanted)), machine.times[-len(wanted) :])
    settled = at[(at > 3.0) & (at < 11.0)]
    return 0.5 * (len(settled) - 1) / (settled[-1] - settled[0])


@pytest.mark.parametrize(
    ("tick", "counts", "words", "within"),
    [
        (lambda _: 1.0 / 46.1, 1, "its tick was 21.69 ms, not 20 ms", 1e-3),
        # When it changes, time goes wrong for a quarter of a second; while it pauses the motion waits.
        (lambda now: 0.02 if now < 5.0 else 0.03, 1, "its tick was 30.00 ms, 20.00 to 30.00 ms on the way", 0.04),
        (lambda _: 0.02, 2, "its tick was 10.00 ms, 10.00 to 20.00 ms on the way", 0.04),
        # One late tick is none that lasts.
        (lambda now: 0.11 if 6.0 < now < 6.02 else 0.02, 1, "its tick was 20.00 ms, 20.00 to 20.95 ms on", 0.04),
        (lambda now: 0.42 if 6.0 < now < 6.02 else 0.02, 1, "it paused once, for up to 0.42 s", 0.06),
    ],
)
def test_the_tick_of_a_machine_is_measured_reported_and_used(tick, counts, words, within):
    sine = {"kind": "sine", "amplitude": [0, 0.05, 0, 0, 0, 0], "angular_frequency": 6.2832}
    machine = Ticking(tick, counts)
    scenario = BASE.replace({"duration": 10.0, "reference": sine})
    start = connected(scenario, machine)
    machine.times, read = [], machine.read
    machine.read = lambda: (reading := read(), machine.times.append(reading.time))[0]
    log = Drive(scenario, machine, start).run()
    assert log.status == "completed"
    (warning,) = [each for each in log.warnings if each["name"] == "machine_tick"]
    assert words in warning["text"]
    assert motion_frequency(machine, log) == pytest.approx(1.0, abs=within)


def test_what_ends_it_before_its_first_tick_is_raised():
    machine = Servos(at=3, event=lost)
    start = connected(BASE, machine)
    with pytest.raises(MachineError, match="lost"):
        Drive(BASE, machine, start).run()
    assert machine.gone


def test_where_the_safety_layer_stops_it_that_is_what_is_told():
    push = {"kind": "step", "time": 1.0, "wrench": [0.0, 0.0, 0.0, 0.0, 0.0, -60.0]}
    scenario = load_scenario("exact_fig7", ["plant.kind=closed_form", "sensors=encoders", "duration=2", "safety={}"])
    scenario = scenario.replace({"estimator": "observer", "tuner": "block", "bounds.crank_angle": 0.02})
    log = driven(Exact(scenario.replace({"disturbances": [push]}), 0), scenario)
    assert (log.status, log.safety["stopped"]["monitor"]) == ("stopped", "unexplained_torque")
