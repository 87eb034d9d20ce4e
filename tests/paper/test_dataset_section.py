import itertools

import numpy as np
import pytest
from made_logs import made_log

from stewart_drake.paper import dataset_section as section_module
from stewart_drake.paper.dataset_section import (
    PAPER_AMPLITUDE,
    PAPER_SAMPLES,
    binding_limits,
    label_spread,
    make,
    run_distances,
    same_ratio,
)
from stewart_drake.paper.study import Study
from stewart_drake.scenario import Scenario
from stewart_drake.training import collect
from stewart_drake.training.collect import FREQUENCIES, OMEGAS, SAMPLES_PER_RUN
from stewart_drake.training.dataset import Dataset, load_dataset

BASE = Scenario()
PAIRS = list(itertools.product(OMEGAS, OMEGAS))
LARGEST = tuple(tuple(np.array([0.6, 0.5, 0.4, 0.1, 0.1, 0.05]) / f) for f in FREQUENCIES)


def made_up(ratio_only=True, runs=9, rows=20, seed=0):
    """Densities that depend on the ratio of the weights alone, or on each run."""
    rng = np.random.default_rng(seed)
    noise = rng.uniform(0.5, 1.5, (5, rows, 12)) if ratio_only else rng.uniform(0.5, 1.5, (runs, rows, 12))
    index = [round(np.log10(q / r)) + 2 for q, r in PAIRS] if ratio_only else list(range(runs))
    inputs = np.concatenate([noise[index[k]] for k in range(runs)])
    return Dataset(
        inputs, np.repeat(PAIRS[:runs], rows, axis=0), np.repeat(np.arange(runs), rows), 0.005 * np.arange(runs * rows)
    )


# --- sizes ---------------------------------------------------------------------------------------------------------


@pytest.fixture
def asked(monkeypatch, runs_by):
    """In place of searches, fixed amplitudes; in place of simulations, logs that depend on the ratio alone."""

    def rule(scenario):
        rows = round(scenario.duration / scenario.controller.period) + 1
        rng = np.random.default_rng(round(1000 + 10 * np.log10(scenario.tuner.omega_q / scenario.tuner.omega_r)))
        signals = {name: rng.normal(size=(rows, 6)) for name in ("error", "torque")}
        weights = np.tile([scenario.tuner.omega_q, scenario.tuner.omega_r], (rows, 1))
        return made_log(rows=rows, step=scenario.controller.period, weights=weights, **signals)

    monkeypatch.setattr(collect, "feasible_amplitudes", lambda *_: (LARGEST, LARGEST))
    monkeypatch.setattr(section_module, "feasible_amplitudes", lambda *_: (LARGEST, LARGEST))
    return runs_by(rule)


# --- what depends on the ratio -------------------------------------------------------------------------------------


def test_distances_between_runs_are_the_largest_difference_of_any_density_at_any_tick():
    data = made_up()
    data.inputs[3 * 20 + 7, 5] += 4.0
    distances = run_distances(data)
    assert distances.shape == (9, 9)
    np.testing.assert_array_equal(distances, distances.T)
    for a, b in itertools.combinations(range(9), 2):
        expected = max(
            abs(x - y) for x, y in zip(data.inputs[data.run == a].flat, data.inputs[data.run == b].flat, strict=True)
        )
        assert distances[a, b] == expected
        assert same_ratio(data)[a, b] == (PAIRS[a][0] * PAIRS[b][1] == pytest.approx(PAIRS[b][0] * PAIRS[a][1]))


def test_the_spread_counts_runs_of_one_ratio_alone():
    data = made_up()
    assert label_spread(data) == 0.0
    lonely = PAIRS.index((0.1, 10.0))  # no other run has this ratio
    data.inputs[data.run == lonely] += 5.0
    assert label_spread(data) == 0.0
    data.inputs[20 * PAIRS.index((1.0, 1.0)) + 3, 11] += 0.25
    assert label_spread(data) == pytest.approx(0.25)
    assert label_spread(made_up(runs=1)) == 0.0


# --- amplitudes ----------------------------------------------------------------------------------------------------


def test_the_limit_that_binds_is_found_around_the_robot_s_own_home():
    base = Scenario.from_dict({"limits": {"clearance": None}})
    high = base.replace({"robot.home_height": 0.32})
    amplitude = np.full((5, 6), 1e-6)
    assert binding_limits(base, amplitude) == binding_limits(high, amplitude) == [["none"] * 6] * 5
    slow = base.replace({"limits.crank_speed": 1e-6})
    assert binding_limits(slow, amplitude) == [["crank_speed"] * 6] * 5
    # At 0.3 m this robot stands far from its home, which is out of its limits; at home it is within them.
    tight = high.replace({"limits.joint_swing": 0.02})
    assert binding_limits(tight, amplitude) == [["none"] * 6] * 5


# --- the section ---------------------------------------------------------------------------------------------------


@pytest.mark.usefixtures("no_pictures")
def test_the_section_s_numbers_are_those_of_the_file_that_it_leaves(tmp_path, asked):
    section = make(Study(tmp_path, False, BASE.replace({"limits.clearance": None, "limits.euler_pitch": None})))
    (wanted,) = asked
    assert [round(s.duration / s.controller.period) for s in wanted] == [SAMPLES_PER_RUN] * 9
    assert [(s.tuner.omega_q, s.tuner.omega_r) for s in wanted] == PAIRS
    n, file = section.numbers, "dataset.parquet"
    assert section.files[1:] == [file]
    data = load_dataset(tmp_path / file)
    assert data.digest() == n["sha256"]
    assert n["samples"] == len(data.run) == PAPER_SAMPLES == 14_400
    assert data.metadata["density"] == BASE.tuner.density
    assert n["largest_amplitude"] == [list(row) for row in LARGEST]
    np.testing.assert_allclose(n["amplitude"], 0.8 * np.array(LARGEST), atol=1e-6)
    np.testing.assert_allclose(data.metadata["amplitude"], n["amplitude"])
    assert n["equal_ratio_spread"] == 0.0
    assert n["next_ratio_spread"] > 1.0
    assert n["distinct"] == 5
    feasible = sum(LARGEST[f][a] >= PAPER_AMPLITUDE[a] for f in range(5) for a in range(6))
    assert n["share_of_paper_amplitudes_feasible"] == pytest.approx(feasible / 30)
    # Only bursts that were run are listed as run.
    rows = {line.split(" | ")[0][2:]: line for line in section.body.split("\n") if line.startswith("| ")}
    assert [name for name in rows if name.endswith("as run")] == [f"{f:g} Hz, as run" for f in FREQUENCIES]
    assert [name for name in rows if name.endswith("alone")] == [f"{f:g} Hz, each axis alone" for f in FREQUENCIES]
    assert rows["1 Hz, as run"].endswith("| 27.5 deg | 22.9 deg | 18.3 deg | 80.0 mm | 80.0 mm | 40.0 mm |")
    assert "| 50.0 mm (" in rows["2 Hz, each axis alone"]
    assert rows["paper, 1 to 5 Hz"].endswith("| 30.0 deg | 30.0 deg | 30.0 deg | 300.0 mm | 300.0 mm | 300.0 mm |")
    assert "the bursts of 1 to 5 Hz" in section.body
    assert "0.3 m at 5 Hz alone is 296 m/s^2" in section.body
    # Only the limits that are on are named.
    assert "reach, conditioning, transmission, joint swing, crank speed, torque;" in section.body
