import dataclasses

import matplotlib as mpl
import matplotlib.style
import numpy as np
import pytest
from made_logs import made_log

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.plotting import draw, plot_states, plot_torques, save_figure
from stewart_drake.plotting.study_plots import plot_error, plot_rmse
from stewart_drake.scenario import Scenario

AXES = ("φ", "θ", "ψ", "X", "Y", "Z")
BOTH = pytest.mark.parametrize("plot", [plot_states, plot_torques])


def make_log(rows=400, tuner="fixed", **changes):
    time = 0.025 * np.arange(rows)
    reference, rate, acceleration = Scenario().reference.evaluate(time)
    phase = time[:, None] + np.arange(1.0, 7.0)
    error, torque = 0.004 * np.sin(phase), 1.5 + np.cos(phase)
    signals = {
        "time": time,
        **{"pose": reference + error, "pose_rate": rate, "error": error, "integral": 0.002 * np.cos(phase)},
        **{"reference": reference, "reference_rate": rate, "reference_acceleration": acceleration},
        **{"torque": torque, "torque_applied": np.clip(torque, -5.0, 5.0), "crank_angle": phase},
        **{"weights": 10.0 ** np.sin(phase[:, :2]), "loop_gap": np.full((rows, 6), 1e-7)},
    }
    return made_log(rows, scenario={"name": "made up", "tuner": {"kind": tuner}}, **signals | changes)


def panel(figure, title):
    return [axes for axes in figure.axes if axes.get_title(loc="left") == title]


def lines(axes):
    symbols = {r"$\phi$": "φ", r"$\theta$": "θ", r"$\psi$": "ψ", r"$\omega_Q$": "omega_q", r"$\omega_R$": "omega_r"}
    return {
        symbols.get(label := line.get_label().split("  ")[0], label): line.get_xydata()
        for line in axes.lines
        if not line.get_label().startswith("_")
    }


def in_unit(log, signal, axis):
    values = log[signal][:, axis]
    return np.degrees(values) if axis < 3 else 1000.0 * values


def test_states_errors_and_integrals_are_drawn_for_every_axis_in_degrees_or_millimetres():
    log = make_log()
    figure = plot_states(log)
    titles = ["Roll", "Pitch and yaw", "Pitch and yaw", "X and Y", "X and Y", "Height"]
    for axis, symbol in enumerate(AXES):
        column, unit = (0, "deg") if axis < 3 else (1, "mm")
        pose, reference = in_unit(log, "pose", axis), in_unit(log, "reference", axis)
        (axes,) = panel(figure, titles[axis])
        np.testing.assert_allclose(lines(axes)[symbol], np.stack([log.time, pose], axis=1))
        dashed = [line.get_ydata() for line in axes.lines if line.get_linestyle() == "--"]
        assert any(np.allclose(values, reference) for values in dashed)
        assert f"[{unit}]" in axes.get_ylabel()
        errors, integrals = (
            panel(figure, title)[column] for title in ("Error and RMS", "Integral state (dotted: 5 s)")
        )
        np.testing.assert_allclose(lines(errors)[symbol][:, 1], pose - reference)
        np.testing.assert_allclose(lines(integrals)[symbol][:, 1], in_unit(log, "integral", axis))
        assert (errors.get_ylabel(), integrals.get_ylabel()) == (f"error [{unit}]", f"z [{unit} s]")
    for axes, key in zip(panel(figure, "Error and RMS"), ("rmse_deg", "rmse_mm"), strict=True):
        shown = [float(text.get_text().split()[-1]) for text in axes.get_legend().get_texts()]
        np.testing.assert_allclose(shown, run_metrics(log)[key], rtol=5e-2)


def test_weights_and_their_ratio_are_drawn_on_logarithmic_axes_and_nothing_is_empty_without():
    log = make_log(tuner="paper")
    figure = plot_states(log)
    (both,) = panel(figure, "Output of the ANN")
    drawn = lines(both)
    np.testing.assert_array_equal(drawn["omega_q"][:, 1], log["weights"][:, 0])
    np.testing.assert_array_equal(drawn["omega_r"][:, 1], log["weights"][:, 1])
    (ratio,) = panel(figure, "Ratio of the weights, on which alone the gain depends")
    np.testing.assert_allclose(ratio.lines[0].get_ydata(), log["weights"][:, 0] / log["weights"][:, 1])
    assert both.get_yscale() == ratio.get_yscale() == "log"
    without = {name: values for name, values in log.signals.items() if "weights" not in name}
    figure = plot_states(dataclasses.replace(log, signals=without))
    assert len(figure.axes) == 8
    assert all(axes.lines for axes in figure.axes)


def test_each_motor_has_its_panel_with_torque_rms_and_peak_on_one_scale():
    log = make_log()
    figure = plot_torques(log)
    for leg in range(6):
        (axes,) = panel(figure, f"Motor {leg}")
        applied = log["torque_applied"][:, leg]
        np.testing.assert_array_equal(lines(axes)["applied"][:, 1], applied)
        rms, peak = np.sqrt(np.mean(applied**2)), np.abs(applied).max()
        assert axes.get_title(loc="right") == f"RMS {rms:#.3g} N m, peak {peak:#.3g} N m"
        assert "commanded" not in lines(axes)
    assert [axes.get_ylabel() for axes in figure.axes] == ["torque [N m]", ""] * 3
    assert len({axes.get_ylim() for axes in figure.axes}) == 1


def test_saturated_torque_shows_the_limit_and_the_command_of_that_motor_alone():
    torque = make_log()["torque"].copy()
    torque[100:, 2] = 80.0
    figure = plot_torques(make_log(torque=torque, torque_applied=np.clip(torque, -5.0, 5.0)))
    assert [("commanded" in lines(axes)) for axes in figure.axes] == [False, False, True, False, False, False]
    np.testing.assert_array_equal(lines(figure.axes[2])["commanded"][:, 1], torque[:, 2])
    for axes in figure.axes:
        assert {5.0, -5.0} <= {line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == ":"}
        # The command is far off the scale; what the motors gave is not flattened by it.
        assert axes.get_ylim()[1] == pytest.approx(7.0)


@BOTH
def test_a_run_says_how_it_ended_and_marks_when(plot):
    assert plot(make_log()).get_suptitle() == "made up: completed, 9.975 s"
    outcome = {"status": "failed", "reason": "crank_dead_centre", "leg": 5, "end_time": 2.48}
    figure = plot(dataclasses.replace(make_log(rows=100), **outcome))
    assert figure.get_suptitle() == "made up: failed at 2.480 s of 10 s: crank_dead_centre, leg 5"
    assert all([span.get_x() for span in axes.patches] == [2.48] for axes in figure.axes)


@pytest.mark.slow
@BOTH
@pytest.mark.parametrize(("value", "rows"), [(1e160, 1), (np.nan, 399)])
def test_a_blow_up_is_drawn_within_bounds(plot, value, rows, tmp_path):
    log = make_log()
    signals = {name: values.copy() for name, values in log.signals.items()}
    for name in ("pose", "integral", "torque", "torque_applied", "weights"):
        signals[name][-rows:] = value
    figure = plot(dataclasses.replace(log, signals=signals, status="failed", reason="crank_dead_centre"))
    assert draw(lambda: figure, tmp_path / "x.png") is None
    assert all(np.isfinite(axes.get_ylim()).all() for axes in figure.axes)


@BOTH
def test_a_single_row_is_a_dot_and_an_empty_log_is_refused(plot):
    figure = plot(dataclasses.replace(make_log(rows=1), status="failed"))
    drawn = [line for axes in figure.axes for line in axes.lines if len(line.get_xdata()) == 1]
    assert {line.get_marker() for line in drawn} == {"o"}
    with pytest.raises(ConfigurationError, match=r"log: expected .*got 'no rows'"):
        plot(make_log(rows=0))


@BOTH
def test_a_picture_is_the_same_every_time_whatever_the_user_s_style_which_stays(plot, tmp_path):
    before = dict(mpl.rcParams)
    save_figure(plot(make_log()), tmp_path / "plain.png")
    assert dict(mpl.rcParams) == before
    with mpl.style.context(["dark_background", {"lines.linewidth": 9.0, "font.size": 20.0, "axes.grid": False}]):
        save_figure(plot(make_log()), tmp_path / "dark.png")
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "dark.png").read_bytes()


def run(controller, rmse, condition="calm", status="completed"):
    trace = {"time": [0.0, 1.0], "pose_mm": [0.0, rmse]}
    named = {"controller": controller, "condition": condition, "reference": "sine", "status": status}
    return {**named, "pose_rmse_mm": rmse, "trace": trace}


def test_a_failed_run_is_a_cross_at_the_edge_and_others_are_where_their_error_is():
    rows = [run("pid", 2.0), run("lqi", 1.0), run("lqi", None, "windy", "failed"), run("pid", 4.0, "windy")]
    calm, windy = plot_rmse(rows).axes
    dots = [line.get_xdata()[0] for line in calm.lines if line.get_marker() not in ("None", "x")]
    assert sorted(dots) == [1.0, 2.0]
    (cross,) = (line for line in windy.lines if line.get_marker() == "x")
    assert 8.0 < cross.get_xdata()[0] < windy.get_xlim()[1]
    assert plot_error(rows[:2], 0.5).axes[0].get_yscale() == "log"
