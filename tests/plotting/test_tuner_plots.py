import numpy as np

from stewart_drake.plotting.tuner_plots import plot_costs, plot_front


def test_a_ratio_beyond_the_figure_stands_at_its_edge_hollow():
    ratios = {"policy": [(0.5, 0.4, 0.6), (1.2, 1.0, 1.4)], "paper": [(300.0, 100.0, 900.0), (2.0, 1.0, 3.0)]}
    figure = plot_costs(["hold", "fast"], ratios, "best fixed")
    panel = figure.axes[0]
    low, high = panel.get_xlim()
    drawn = [line for line in panel.lines if line.get_marker() not in ("None", None)]
    places = np.concatenate([line.get_xdata() for line in drawn])
    assert ((places > low) & (places < high)).all()
    hollow = [line for line in drawn if line.get_markerfacecolor() == "white" and len(line.get_xdata())]
    assert len(hollow) == 1
    assert [text.get_text() for text in panel.get_yticklabels()] == ["hold", "fast"]


def test_the_front_names_each_taste():
    tuner = np.array([[0.01, 0.02], [0.02, 0.01]])
    figure = plot_front(np.array([[0.03, 0.03]]), tuner, [-1.0, 1.0], tuner)
    panel = figure.axes[0]
    assert [text.get_text() for text in panel.texts] == ["-1", "1"]
    assert panel.get_xscale() == panel.get_yscale() == "log"
