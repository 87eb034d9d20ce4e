import dataclasses

import matplotlib as mpl
import matplotlib.style
import numpy as np
import pytest
from made_logs import made_log

from stewart_drake import Scenario, plot_states, plot_torques, run_metrics
from stewart_drake.plotting import plot_learnt, save_figure, study_plots
from stewart_drake.plotting.study_plots import plot_map, plot_rmse, plot_sweep

AXES = ("φ", "θ", "ψ", "X", "Y", "Z")
EACH = pytest.mark.parametrize("plot", [plot_states, plot_torques, plot_learnt])


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


def lines(axes):
    symbols = {r"$\phi$": "φ", r"$\theta$": "θ", r"$\psi$": "ψ", r"$\omega_Q$": "omega_q", r"$\omega_R$": "omega_r"}
    return {
        symbols.get(label := line.get_label().split("  ")[0], label): line.get_xydata()
        for line in axes.lines
        if not line.get_label().startswith("_")
    }


def test_states_are_drawn_for_the_axes_that_move_and_errors_for_those_that_err():
    log = make_log()
    figure = plot_states(log)
    titles = [axes.get_title(loc="left") for axes in figure.axes]
    assert titles == ["Roll", "Z", "Error", "Error", "Integral state", "Integral state", *titles[6:]]
    for axes, axis, scale, unit in ((figure.axes[0], 0, np.degrees(1.0), "deg"), (figure.axes[1], 5, 1e3, "mm")):
        pose, reference = axes.lines
        np.testing.assert_allclose(pose.get_ydata(), scale * log["pose"][:, axis])
        np.testing.assert_allclose(reference.get_ydata(), scale * log["reference"][:, axis])
        assert (axes.get_ylabel(), reference.get_linestyle()) == (f"pose [{unit}]", "--")
    error = log["pose"] - log["reference"]
    for axes, axis in zip([figure.axes[2]] * 3 + [figure.axes[3]] * 3, range(6), strict=True):
        scale = np.degrees(1.0) if axis < 3 else 1e3
        np.testing.assert_allclose(lines(axes)[AXES[axis]][:, 1], scale * error[:, axis])
    shown = [float(text.get_text().split()[-1]) for text in figure.axes[3].get_legend().get_texts()]
    np.testing.assert_allclose(shown, run_metrics(log)["rmse_mm"], rtol=5e-2)
    # What errs by less than a tenth of the largest is left out.
    error[:, :5] *= 0.01
    figure = plot_states(make_log(pose=log["reference"] + error))
    assert [axes.get_title(loc="left") for axes in figure.axes[:4]] == ["Roll", "Z", "Error", "Integral state"]
    assert list(lines(figure.axes[2])) == ["Z"]


def test_weights_and_settings_are_drawn_where_they_change_and_nothing_is_empty():
    log = make_log(tuner="paper")
    without = {name: values for name, values in log.signals.items() if name not in ("weights", "setting", "ball")}
    setting = np.zeros((400, 5)) + np.linspace(0.0, 1.0, 400)[:, None] * [1.0, 0.0, 1.0, 1.0, 0.0]
    both, ratio = plot_states(dataclasses.replace(log, signals={**without, "weights": log["weights"]})).axes[-2:]
    np.testing.assert_array_equal(lines(both)["omega_q"][:, 1], log["weights"][:, 0])
    np.testing.assert_allclose(ratio.lines[0].get_ydata(), log["weights"][:, 0] / log["weights"][:, 1])
    assert both.get_yscale() == ratio.get_yscale() == "log"
    for more, last in (({"weights": np.ones((400, 2))}, "Integral state"), ({"setting": setting}, "Tuner")):
        drawn = [a for a in plot_states(dataclasses.replace(log, signals={**without, **more})).axes if a.axison]
        assert drawn[-1].get_title(loc="left") == last


def test_each_motor_has_its_panel_with_torque_rms_and_peak_on_one_scale():
    log = make_log()
    figure = plot_torques(log)
    for leg in range(6):
        axes = figure.axes[leg]
        assert axes.get_title(loc="left") == f"Motor {leg}"
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
        assert axes.get_ylim()[1] == pytest.approx(7.0)


@EACH
def test_a_plot_names_how_the_run_ended_and_marks_when(plot):
    assert plot(make_log()).get_suptitle() == "made up: completed, 9.975 s"
    outcome = {"status": "failed", "reason": "crank_dead_centre", "leg": 5, "end_time": 2.48}
    figure = plot(dataclasses.replace(make_log(rows=100), **outcome))
    assert figure.get_suptitle() == "made up: failed at 2.480 s of 10 s: crank_dead_centre, leg 5"
    assert all([span.get_x() for span in axes.patches] == [2.48] for axes in figure.axes if axes.axison)


@EACH
def test_nothing_is_cut_off_and_the_headline_is_free(plot):
    figure = plot(make_log())
    figure.draw_without_rendering()
    whole, inner = figure.bbox, figure.get_tightbbox()
    assert 0.0 <= inner.x0 < inner.x1 <= whole.width / figure.dpi
    assert 0.0 <= inner.y0 < inner.y1 <= whole.height / figure.dpi
    headline = min(text.get_window_extent().y0 for text in figure.texts)
    assert max(panel.get_tightbbox().y1 for panel in figure.axes if panel.axison) < headline


@pytest.mark.slow
@EACH
@pytest.mark.parametrize(("value", "rows"), [(1e160, 1), (np.nan, 399)])
def test_a_blow_up_is_drawn_within_bounds(plot, value, rows, tmp_path):
    log = make_log()
    signals = {name: values.copy() for name, values in log.signals.items()}
    for name in ("pose", "integral", "torque", "torque_applied", "weights"):
        signals[name][-rows:] = value
    figure = plot(dataclasses.replace(log, signals=signals, status="failed", reason="crank_dead_centre"))
    save_figure(figure, tmp_path / "x.png")
    assert all(np.isfinite(axes.get_ylim()).all() for axes in figure.axes if axes.axison)


def test_a_picture_is_the_same_every_time_whatever_the_user_s_style_which_stays(tmp_path):
    before = dict(mpl.rcParams)
    save_figure(plot_torques(make_log()), tmp_path / "plain.png")
    assert dict(mpl.rcParams) == before
    with mpl.style.context(["dark_background", {"lines.linewidth": 9.0, "font.size": 20.0, "axes.grid": False}]):
        save_figure(plot_torques(make_log()), tmp_path / "dark.png")
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "dark.png").read_bytes()


def test_a_comparison_draws_the_error_that_its_table_has():
    about = {"controller": "one", "condition": "calm", "reference": "hold", "status": "completed"}
    figure = plot_rmse([{**about, "rmse_norm_mm": 0.25, "rmse_norm_deg": 9.0, "pose_rmse_mm": 18.0}])
    drawn = [line.get_xdata()[0] for line in figure.axes[0].lines if line.get_marker() not in ("None", "", None)]
    assert drawn == [0.25]
    assert figure.axes[-1].get_xlabel() == "RMSE [mm]"


def test_a_sweep_shows_runs_that_were_lost_at_the_edge_and_two_grids_as_a_map():
    rows = [
        {"status": status, "rmse_norm_mm": error, "mass": mass, "friction": friction}
        for (mass, friction, error, status) in [
            (0.0, 0.1, 1.0, "completed"),
            (0.0, 0.2, 2.0, "completed"),
            (0.5, 0.1, 3.0, "completed"),
            (0.5, 0.2, None, "failed"),
        ]
    ]
    varied = {"mass": "mass [kg]", "friction": "friction"}
    panels = plot_sweep(rows, varied).axes[:2]
    assert [panel.get_xlabel() for panel in panels] == ["mass [kg]", "friction"]
    kept, lost = panels[0].lines
    assert kept.get_ydata().tolist() == [1.0, 2.0, 3.0]
    assert (lost.get_xdata().tolist(), lost.get_ydata()[0] > 3.0) == ([0.5], True)
    (cells,) = plot_map(rows, varied).axes[0].images
    assert cells.get_array().filled(np.nan).tolist()[0] == [1.0, 3.0]
    assert cells.get_array().filled(np.nan)[1, 0] == 2.0
    assert cells.get_array().mask[1, 1]


def test_sixteen_controllers_have_sixteen_looks():
    styles = study_plots._styles([{"controller": str(number)} for number in range(16)])
    looks = {tuple(style.get(key) for key in ("color", "marker", "markerfacecolor")) for style in styles.values()}
    assert len(looks) == 16
