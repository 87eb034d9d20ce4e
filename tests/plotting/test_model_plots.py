"""Pictures of calibration, identification and margins."""

import numpy as np
from simulated_identification import deviating, recorded

from stewart_drake import RobotParameters, SineReference, identify
from stewart_drake.hardware.sensors import EncoderOptions
from stewart_drake.plotting import model_plots


def test_an_identification_shows_each_motor_s_torque_over_time_and_what_is_left_over_the_rate(monkeypatch):
    robot, rng = RobotParameters(), np.random.default_rng(0)
    way = {"amplitude": (0.2, 0.15, 0.1, 0.01, 0.02, 0.01), "angular_frequency": (5.0, 7.0, 3.0, 6.0, 4.0, 8.0)}
    motion = SineReference(center=tuple(robot.home_pose), **way)
    exact = EncoderOptions(resolution_bits=0)
    found = identify(robot, [recorded(robot, deviating(robot, rng, 0.02, 0.01), motion, 8.0, 250.0, exact, 0.0, rng)])
    drawn = []
    monkeypatch.setattr(model_plots.look, "save_figure", lambda figure, _: drawn.append(figure))
    model_plots.plot_identification(found, "identification.png")
    drawn[0].draw_without_rendering()
    over_time, over_rate = np.reshape(drawn[0].axes, (6, 2)).T
    for motor, (left, right) in enumerate(zip(over_time, over_rate, strict=True)):
        assert left.get_title("left") == f"Motor {motor}"
        torque = left.lines[0].get_ydata()
        np.testing.assert_array_equal(torque, found.samples.measured[found.samples.pieces[0]][: len(torque), motor])
        assert np.nanmax(np.abs(left.lines[1].get_ydata())) < 0.01 * np.ptp(torque)
        assert right.lines[0].get_xdata().size > 500
        assert left.get_position().width > 1.5 * right.get_position().width
    assert over_time[-1].get_xlabel() == "time [s]"
    assert over_rate[-1].get_xlabel() == "crank rate [rad/s]"
