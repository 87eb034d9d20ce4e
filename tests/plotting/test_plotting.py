import dataclasses
import subprocess
import sys

import matplotlib as mpl
import matplotlib.style
import numpy as np
import pytest
from made_logs import made_log
from matplotlib.image import imread

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.metrics import run_metrics
from stewart_drake.plotting import DPI, draw, plot_states, plot_torques, save_figure
from stewart_drake.scenario import Scenario

AXES = ("φ", "θ", "ψ", "X", "Y", "Z")
MAIN = {"φ", "Z"}


def make_log(rows=400, tuner="fixed", **changes):
    """A log of smooth signals, every component different from every other."""
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


def failed(log, **outcome):
    outcome = {"status": "failed", "reason": "crank_dead_centre", "message": "of leg 5", "leg": 5} | outcome
    return dataclasses.replace(log, **outcome)


def panel(figure, title):
    """The panels with this title, left column first."""
    return [axes for axes in figure.axes if axes.get_title(loc="left") == title]


def lines(axes):
    """Label without mathematics' markup -> data (n, 2) of the lines that a legend would name."""
    symbols = {r"$\phi$": "φ", r"$\theta$": "θ", r"$\psi$": "ψ", r"$\omega_Q$": "omega_q", r"$\omega_R$": "omega_r"}
    return {
        symbols.get(label := line.get_label().split("  ")[0], label): line.get_xydata()
        for line in axes.lines
        if not line.get_label().startswith("_")
    }


def in_unit(log, signal, axis):
    values = log[signal][:, axis]
    return np.degrees(values) if axis < 3 else 1000.0 * values


def texts(figure):
    found = [figure.get_suptitle(), *(text.get_text() for text in figure.texts)]
    return found + [text.get_text() for axes in figure.axes for text in axes.texts]


@pytest.mark.slow
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
        assert len(dashed) == (1 if symbol in MAIN else 2)
        assert any(np.allclose(values, reference) for values in dashed)
        assert f"[{unit}]" in axes.get_ylabel()
        errors, integrals = (
            panel(figure, title)[column] for title in ("Error and RMS", "Integral state (dotted: 5 s)")
        )
        np.testing.assert_allclose(lines(errors)[symbol][:, 1], pose - reference)
        np.testing.assert_allclose(lines(integrals)[symbol][:, 1], in_unit(log, "integral", axis))
        assert (errors.get_ylabel(), integrals.get_ylabel()) == (f"error [{unit}]", f"z [{unit} s]")
        assert any(np.all(np.asarray(line.get_xdata()) == 5.0) for line in integrals.lines)
    for axes, key in zip(panel(figure, "Error and RMS"), ("rmse_deg", "rmse_mm"), strict=True):
        shown = [float(text.get_text().split()[-1]) for text in axes.get_legend().get_texts()]
        np.testing.assert_allclose(shown, run_metrics(log)[key], rtol=5e-2)


def test_weights_and_their_ratio_are_drawn_on_logarithmic_axes():
    log = make_log(tuner="paper")
    figure = plot_states(log)
    (both,) = panel(figure, "Output of the ANN")
    drawn = lines(both)
    np.testing.assert_array_equal(drawn["omega_q"][:, 1], log["weights"][:, 0])
    np.testing.assert_array_equal(drawn["omega_r"][:, 1], log["weights"][:, 1])
    (ratio,) = panel(figure, "Ratio of the weights, on which alone the gain depends")
    np.testing.assert_allclose(ratio.lines[0].get_ydata(), log["weights"][:, 0] / log["weights"][:, 1])
    assert both.get_yscale() == ratio.get_yscale() == "log"


def test_constant_weights_sit_inside_their_panel():
    figure = plot_states(make_log(weights=np.ones((400, 2))))
    (axes,) = panel(figure, "Weights, held fixed")
    low, high = axes.get_ylim()
    assert low <= 0.1 < 1.0 < 10.0 <= high * 1.001


@pytest.mark.slow
def test_panels_share_one_time_axis_in_seconds():
    log = make_log()
    for figure in (plot_states(log), plot_torques(log)):
        assert {axes.get_xlim() for axes in figure.axes} == {(0.0, log.time[-1])}
        assert [axes.get_xlabel() for axes in figure.axes if axes.get_xlabel()] == ["time [s]"] * 2


def test_noise_does_not_fill_a_panel():
    still = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, 0.3], (400, 1))
    noise = 1e-12 * np.random.default_rng(0).standard_normal((400, 6))
    figure = plot_states(make_log(reference=still, pose=still + noise))
    for axes in (*panel(figure, "Roll"), *panel(figure, "Pitch and yaw")):
        low, high = axes.get_ylim()
        assert high - low >= 0.99


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
    assert figure.legends == []
    # The limit is not drawn far from it.
    assert not [line for axes in figure.axes for line in axes.lines if line.get_linestyle() == ":"]


def test_saturated_torque_shows_the_limit_and_the_command_of_that_motor_alone():
    torque = make_log()["torque"].copy()
    torque[100:, 2] = 80.0
    log = make_log(torque=torque, torque_applied=np.clip(torque, -5.0, 5.0))
    figure = plot_torques(log)
    assert [("commanded" in lines(axes)) for axes in figure.axes] == [False, False, True, False, False, False]
    np.testing.assert_array_equal(lines(figure.axes[2])["commanded"][:, 1], torque[:, 2])
    for axes in figure.axes:
        assert {5.0, -5.0} <= {line.get_ydata()[0] for line in axes.lines if line.get_linestyle() == ":"}
        # The command is far off the scale; what the motors gave is not flattened by it.
        assert axes.get_ylim()[1] == pytest.approx(7.0)
    (legend,) = figure.legends
    assert sorted(text.get_text() for text in legend.get_texts()) == ["applied", "commanded", "limit ±5 N m"]


OUTCOMES = {
    "completed": ({}, "made up: completed, 9.975 s"),
    "failed": (
        {"status": "failed", "reason": "crank_dead_centre", "leg": 5, "end_time": 2.48},
        "made up: failed at 2.480 s of 10 s: crank_dead_centre, leg 5",
    ),
    "interrupted": (
        {"status": "interrupted", "reason": "interrupted", "end_time": 2.48},
        "made up: interrupted at 2.480 s of 10 s",
    ),
}


@pytest.mark.parametrize("plot", [plot_states, plot_torques])
@pytest.mark.parametrize("status", OUTCOMES)
def test_a_run_says_how_it_ended_and_marks_when(plot, status):
    outcome, title = OUTCOMES[status]
    figure = plot(dataclasses.replace(make_log(rows=100 if outcome else 400), **outcome))
    assert figure.get_suptitle() == title
    assert texts(figure).count("crank_dead_centre") == (2 if status == "failed" else 0)
    for axes in figure.axes:
        assert [span.get_x() for span in axes.patches] == ([2.48] if outcome else [])
        assert not outcome or any(np.all(np.asarray(line.get_xdata()) == 2.48) for line in axes.lines)


@pytest.mark.slow
@pytest.mark.parametrize("plot", [plot_states, plot_torques])
@pytest.mark.parametrize(("value", "rows"), [(1e160, 1), (-1e308, 200), (np.inf, 1), (np.nan, 200), (np.nan, 399)])
def test_a_blow_up_is_drawn_within_bounds_and_leaves_the_rest_readable(plot, value, rows, tmp_path):
    log = make_log()
    signals = {name: values.copy() for name, values in log.signals.items()}
    for name in ("pose", "integral", "torque", "torque_applied", "weights"):
        signals[name][-rows:] = value
    figure = plot(failed(dataclasses.replace(log, signals=signals)))
    assert draw(lambda: figure, tmp_path / "x.png") is None
    assert imread(tmp_path / "x.png").shape[2] == 4
    assert all(np.isfinite(axes.get_ylim()).all() for axes in figure.axes)


@pytest.mark.slow
@pytest.mark.parametrize("plot", [plot_states, plot_torques])
def test_the_shortest_logs_are_drawn_a_single_row_as_a_dot(plot):
    for rows in (1, 2, 3):
        figure = plot(failed(make_log(rows=rows)))
        drawn = [line for axes in figure.axes for line in axes.lines if len(line.get_xdata()) == 1]
        assert {line.get_marker() for line in drawn} == ({"o"} if rows == 1 else set())


@pytest.mark.parametrize("plot", [plot_states, plot_torques])
def test_empty_log_is_refused(plot):
    with pytest.raises(ConfigurationError, match=r"log: expected .*got 'no rows'"):
        plot(make_log(rows=0))


@pytest.mark.slow
@pytest.mark.parametrize("plot", [plot_states, plot_torques])
def test_png_has_the_figure_s_size_and_is_the_same_every_time(plot, tmp_path):
    for name in ("one.png", "two.png"):
        figure = plot(make_log())
        save_figure(figure, tmp_path / name)
    width, height = (figure.get_size_inches() * DPI).round().astype(int)
    image = imread(tmp_path / "one.png")
    assert image.shape == (height, width, 4)
    assert 0.01 < np.mean(image[..., :3].min(axis=-1) < 0.9) < 0.5
    assert (tmp_path / "one.png").read_bytes() == (tmp_path / "two.png").read_bytes()
    assert sorted(path.name for path in tmp_path.iterdir()) == ["one.png", "two.png"]


@pytest.mark.slow
def test_nothing_of_the_user_s_matplotlib_changes():
    before = dict(mpl.rcParams)
    plot_states(make_log())
    plot_torques(make_log())
    assert dict(mpl.rcParams) == before
    code = "import sys, stewart_drake.plotting; assert 'matplotlib.pyplot' not in sys.modules"
    subprocess.run([sys.executable, "-c", code], check=True, timeout=60)


@pytest.mark.parametrize("plot", [plot_states, plot_torques])
def test_style_of_the_user_s_matplotlib_does_not_leak_in(plot, tmp_path):
    save_figure(plot(make_log()), tmp_path / "plain.png")
    with mpl.style.context(["dark_background", {"lines.linewidth": 9.0, "font.size": 20.0, "axes.grid": False}]):
        save_figure(plot(make_log()), tmp_path / "dark.png")
    assert (tmp_path / "plain.png").read_bytes() == (tmp_path / "dark.png").read_bytes()
