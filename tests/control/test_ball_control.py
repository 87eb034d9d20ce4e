"""The loop that balances a ball: its gain, its estimate, and a reference that the robot can follow."""

import numpy as np
import pytest

from stewart_drake import ConfigurationError, Scenario
from stewart_drake.base.sampling import on_grid
from stewart_drake.control.ball_control import BallControlOptions, BallTarget
from stewart_drake.loop.part import LoopRunner
from stewart_drake.scenario.control_side import control_side

BALL = {
    "sensor": {"period": 0.02, "delay": 0.03, "noise": 1e-6},
    "mass": 0.1,
    "radius": 0.03,
    "plate": {"height": 0.05},
}
LOOP = {
    "reference": "hold",
    "plant": "closed_form",
    "sensors": "encoders",
    "estimator": "observer",
    "command_delay": 3,
    "controller": {"period": 0.01, "solver": "split"},
    "ball": BALL,
}


def part_of(**options):
    scenario = Scenario(**LOOP, ball_control=options)
    (part,) = [part for part in control_side(scenario, split=True).parts if part.name == "ball_control"]
    return scenario, part


def test_the_gain_is_that_of_drake():
    from pydrake.math import DiscreteAlgebraicRiccatiEquation
    from scipy.linalg import expm

    options, (tilt, bend), period = BallControlOptions(), (7.0, -0.03), 0.01
    model = np.zeros((5, 5))
    model[0, 1] = model[2, 3] = model[3, 4] = 1.0
    model[1, 2], model[1, 4] = tilt, bend
    a, b = np.split(expm(period * model)[:4], [4], axis=1)
    q, r = np.diag([options.q_place, options.q_velocity, options.q_tilt, options.q_rate]), np.array([[options.r]])
    p = DiscreteAlgebraicRiccatiEquation(a, b, q, r)
    gain = np.linalg.solve(r + b.T @ p @ b, b.T @ p @ a)[0]
    np.testing.assert_allclose(options.gain(tilt, bend, period), gain, rtol=1e-8)


def simulated(part, seconds, reading, target=(0.0,) * 10):
    """Runs the part alone: its references (n, 18) now and ahead, and the estimates (n, 4)."""
    period = 0.01
    sizes = {"unturned_reference": 18, "unturned_reference_ahead": 18, "ball_reading": 2, "ball_target": 10}
    runner, rows = LoopRunner([part], sizes, period=period), []
    runner.signal("ball_target")[:] = target
    for n in range(round(seconds / period)):
        runner.time[0] = n * on_grid(period)
        runner.signal("ball_reading")[:] = reading(n, rows)
        runner.run(n)
        rows.append(np.concatenate([runner.signal(name) for name in ("reference", "reference_ahead", "ball_estimate")]))
    return np.split(np.array(rows), [18, 36], axis=1)


def test_the_reference_is_a_motion_within_the_limits():
    """Whatever the sensor reads, rates and accelerations are the derivatives, and no limit is exceeded."""
    rng, limits = np.random.default_rng(1), {"max_tilt": 0.1, "max_rate": 0.8, "max_acceleration": 12.0}
    _, part = part_of(**limits)
    now, ahead, _ = simulated(part, 8.0, lambda n, _: rng.uniform(-0.1, 0.1, 2) if n % 7 else [np.nan] * 2)
    for rows in (now, ahead):
        pose, rate, acceleration = np.split(rows, 3, axis=1)
        np.testing.assert_allclose(np.diff(rate, axis=0), 0.01 * acceleration[:-1], atol=1e-9)
        moved = 0.01 * rate[:-1] + 0.5 * 0.01**2 * acceleration[:-1]
        np.testing.assert_allclose(np.diff(pose, axis=0), moved, atol=1e-9)
        assert 0.09 < np.abs(pose[:, :2]).max() <= 0.1 + 1e-9
        assert np.abs(rate[:, :2]).max() <= 0.8 + 1e-9
        assert np.abs(acceleration[:, :2]).max() <= 12.0 + 1e-9
        assert not rows[:, 2:6].any()
    np.testing.assert_allclose(now[3:], ahead[:-3], atol=1e-9, err_msg="ahead by the delay of commands")


def test_old_readings_and_late_commands_are_counted():
    """A linear ball, seen 3 ticks late, under tilts that act 3 ticks late: it comes to rest, the estimate is exact."""
    scenario, part = part_of()
    tilt, bend = scenario.ball.per_tilt(9.81)
    path, force = [np.array([0.04, -0.02, 0.1, 0.05])], 0.2  # [m/s^2] that the model does not know.

    def reading(n, rows):
        if n > 0:
            # `reference` is the tilt that is there now.
            roll, pitch, *_ = rows[-1][:2]
            rates, bends = rows[-1][6:8], rows[-1][12:14]
            tilts, h = np.array([[pitch, -roll], [rates[1], -rates[0]], [bends[1], -bends[0]]]), 0.01
            x, v = path[-1][:2], path[-1][2:]
            pull = bend * tilts[2] + force
            moved = tilt * (tilts[0] / 2 + h * tilts[1] / 6 + h**2 * tilts[2] / 24) + pull / 2
            gained = tilt * (tilts[0] + h * tilts[1] / 2 + h**2 * tilts[2] / 6) + pull
            path.append(np.concatenate([x + h * v + h**2 * moved, v + h * gained]))
        return path[max(0, n - 3)][:2] if n % 2 == 0 else [np.nan] * 2

    _, _, estimate = simulated(part, 6.0, reading)
    assert np.linalg.norm(path[-1][:2]) < 1e-5
    np.testing.assert_allclose(estimate[300:-3], path[303:], atol=1e-6)


def test_without_readings_the_plate_goes_level():
    _, part = part_of()
    now, _, _ = simulated(part, 6.0, lambda n, _: [0.05, 0.05] if n < 100 and n % 2 == 0 else [np.nan] * 2)
    assert np.abs(now[90:120, :2]).max() > 0.05
    assert np.abs(now[-1]).max() < 1e-4


def test_a_circle_is_a_path_with_its_derivatives():
    target, h = BallTarget(center=(0.01, 0.0), radius=0.03, turn_time=3.0, begin=1.0), 1e-4
    times = np.linspace(0.0, 9.0, 500)
    for order in range(3):
        below, above = (target.evaluate(times + side * h)[:, 2 * order : 2 * order + 2] for side in (-0.5, 0.5))
        value = target.evaluate(times)[:, 2 * order + 2 : 2 * order + 4]
        np.testing.assert_allclose((above - below) / h, value, atol=2e-2 * np.abs(value).max())
    assert not target.evaluate(np.array([0.9]))[0, 2:].any()
    late = target.evaluate(np.linspace(5.0, 9.0, 50))[:, :2]
    np.testing.assert_allclose(np.linalg.norm(late - [0.01, 0.0], axis=1), 0.03, rtol=1e-12)
    hexagon = BallTarget(
        motion={"kind": "sine", "amplitude": [0.1, 0, 0, 0.02, 0.0, 0], "angular_frequency": [1.0] * 6}
    )
    np.testing.assert_allclose(hexagon.evaluate(np.array([np.pi / 2]))[0, :4], [0.02, 0.0, 0.0, 0.0], atol=1e-12)


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"ball.start": [0.2, 0.0]}, r"ball\.start: expected a place on the plate"),
        ({"ball.radius": 0.0}, r"ball\.radius: expected a number \[m\] at least 0.001"),
        ({"ball.sensor.period": 0.015}, r"ball\.sensor\.period: expected a whole multiple of controller\.period"),
        ({"plant.kind": "mujoco"}, r"plant\.kind: expected closed_form or drake, for a ball"),
        ({"ball": None}, "ball_control: expected null, or a ball"),
        ({"ball": None, "ball_control": None, "model.ball": {}}, r"model\.ball: expected null, because ball is null"),
        ({"gravity": -9.81}, "gravity: expected gravity within 45 deg of -z"),
        ({"reference": "stream"}, "ball_control: expected null, with a reference of kind stream"),
        ({"base": {"motion": "sine"}}, r"base\.motion: expected null, for a ball on the platform"),
    ],
    ids=lambda value: next(iter(value)) if isinstance(value, dict) else "",
)
def test_what_does_not_fit_is_one_line(changes, message):
    with pytest.raises(ConfigurationError, match=message):
        Scenario(**LOOP, ball_control={}).replace(changes)


def test_what_only_the_loop_can_tell():
    with pytest.raises(ConfigurationError, match=r"ball_control\.r: expected weights that lie closer together"):
        part_of(q_place=1e300)
    scenario = Scenario(**{**LOOP, "controller": {"period": 0.001}}, ball_control={})
    with pytest.raises(ConfigurationError, match=r"ball\.sensor\.delay: expected at most 0\.19"):
        control_side(scenario.replace({"ball.sensor.delay": 0.5}), split=True)
