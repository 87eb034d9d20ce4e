import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from strategies import ROBOT

from stewart_drake.cli.workspace_command import workspace
from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import SimulationLog
from stewart_drake.mechanics.dynamics import inverse_dynamics
from stewart_drake.mechanics.kinematics import inverse_kinematics
from stewart_drake.paper import workspace_section as section_module
from stewart_drake.paper.pose_study import KINDS, motion_slice, slice_surveys, survey_poses
from stewart_drake.paper.rendering import render
from stewart_drake.paper.study import Study
from stewart_drake.paper.visited_region import controlled_motions, findings, visited_region
from stewart_drake.paper.workspace_section import sizes
from stewart_drake.planning.limits import Limits
from stewart_drake.planning.workspace import measure_poses
from stewart_drake.planning.workspace_region import COORDINATES, losses, poses_at, utilisation
from stewart_drake.plotting.envelope_plots import plot_motion_map, plot_state_region, plot_torque_region
from stewart_drake.plotting.workspace_plots import plot_boundaries, plot_capability, plot_losses, plot_slices
from stewart_drake.references import SineReference, paper_reference
from stewart_drake.runs.simulation import check_scenario
from stewart_drake.scenario import Scenario


def perfect_log(scale=1.0, status="completed", offset=0.0, scenario=None):
    """A run that follows the paper's reference exactly, torques from the exact inverse dynamics times `scale`."""
    scenario = Scenario() if scenario is None else scenario
    time = np.linspace(0.0, 3.2, 161)
    pose, rate, acceleration = paper_reference().evaluate(time)
    torque = inverse_dynamics(ROBOT, pose, rate, acceleration, scenario.gravity)
    moved = pose + [0.0, 0.0, 0.0, 0.0, 0.0, offset]
    signals = {
        "time": time,
        "pose": moved,
        "pose_rate": rate,
        "reference": pose,
        "reference_rate": rate,
        "reference_acceleration": acceleration,
        "crank_angle": inverse_kinematics(ROBOT, moved),
        "torque_applied": scale * torque,
    }
    reason = None if status == "completed" else "crank_dead_centre"
    return SimulationLog(scenario, signals, status=status, reason=reason, end_time=3.2)


@pytest.fixture(scope="module")
def study(tmp_path_factory):
    return Study(tmp_path_factory.mktemp("study"), quick=True)


@pytest.fixture(scope="module")
def poses(study):
    return survey_poses(study, 3000, ROBOT.home_pose)


def test_ranges_end_where_a_limit_is_met(poses):
    for end in (0, 1):
        pose = np.tile(ROBOT.home_pose, (6, 1))
        np.fill_diagonal(pose, poses.ranges[end])
        use = utilisation(ROBOT, Limits(), pose, measure_poses(ROBOT, pose))
        np.testing.assert_allclose(np.max(list(use.values()), axis=0), 1.0, atol=1e-3)
    assert (poses.ranges[0] < ROBOT.home_pose).all()
    assert (poses.ranges[1] > ROBOT.home_pose).all()


def test_the_inscribed_radius_is_free_in_every_direction(poses):
    rng = np.random.default_rng(0)
    direction = rng.normal(size=(500, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    for kind in KINDS:
        columns = COORDINATES[kind]
        way = 0.99 * poses.boundaries[kind].radius.min() * rng.random((500, 1)) * direction
        pose = poses_at(columns, ROBOT.home_pose, ROBOT.home_pose[list(columns)] + way)
        use = utilisation(ROBOT, Limits(), pose, measure_poses(ROBOT, pose))
        assert np.max(list(use.values())) <= 1.0


def test_centers_out_of_reach_become_an_empty_row(study):
    found = survey_poses(study, 1000, np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.395]))
    missing = [name for name, _, survey in found.others if survey is None]
    assert "roll 30 deg" in missing
    assert [sizes(kind, survey) for name, kind, survey in found.others if name == "roll 30 deg"] == [["-"] * 5]


def test_slices_go_through_the_centre_and_along_the_third_coordinate(study, poses):
    for kind in KINDS:
        slices = slice_surveys(study, poses, kind)
        assert len(slices) == 6
        flat = [found.grid.counts.index(1) for found in slices]
        assert flat[:5] == [2] * 5
        assert flat[5] != 2
        middle = ROBOT.home_pose[COORDINATES[kind][2]]
        assert any(found.grid.axes[2][0] == pytest.approx(middle, abs=1e-12) for found in slices[:5])


def test_the_motions_slice_lies_in_the_two_coordinates_that_move(study, poses):
    found = motion_slice(study, poses, perfect_log()["reference"])
    moving = [c for c, n in zip(found.grid.coordinates, found.grid.counts, strict=True) if n > 1]
    assert moving == [0, 5]
    still = motion_slice(study, poses, np.tile(ROBOT.home_pose, (5, 1)))
    assert [c for c, n in zip(still.grid.coordinates, still.grid.counts, strict=True) if n > 1] == [0, 5]


def test_what_a_perfect_run_visits():
    region = visited_region("perfect", perfect_log())
    assert region.peak_torque == pytest.approx(region.reference_torque, rel=1e-12)
    assert region.torque_use == pytest.approx(region.peak_torque / 5.0)
    assert region.worst == region.reference_worst
    # The paper's reference needs 63.1 deg of the 65 deg that the universal joints have.
    assert region.worst[1] == "universal_swing"
    assert region.worst[0] == pytest.approx(63.1 / 65.0, abs=2e-3)
    np.testing.assert_allclose(np.degrees(region.envelope.pose[:, 0]), [-30.0, 30.0], atol=0.01)
    assert region.speed == np.abs(region.envelope.crank_rate).max()
    assert region.power == np.abs(region.envelope.power).max()


def verdict(*logs, runs=None, names=("the paper's motion", "fast", "broken")):
    regions = [visited_region(name, log) for name, log in zip(names, logs, strict=False)]
    return render("workspace", "verdict", **findings(regions, len(regions) if runs is None else runs)), regions


def test_verdict_when_torques_depend_on_the_motion():
    text, regions = verdict(perfect_log(), perfect_log(scale=4.0))
    assert text.startswith("Holds in part: 2 of 2 controlled motions")
    assert f"from {regions[0].peak_torque:.2f} to {4.0 * regions[0].peak_torque:.2f} N m. The paper's motion" in text
    assert "not to the method" in text
    assert "beyond a limit" not in text


def test_verdict_when_they_do_not():
    text, _ = verdict(perfect_log(), perfect_log(scale=1.2))
    assert text.startswith("Holds: 2 of 2")
    assert "the motors' limit), and the largest torque hardly depends on the motion (from" in text


def test_verdict_counts_failed_runs_and_names_poses_beyond_a_limit():
    text, _ = verdict(perfect_log(offset=0.012), perfect_log(), perfect_log(scale=9.0, status="failed"))
    # A run that did not end counts for nothing in the spread, but keeps the claim from holding.
    assert text.startswith("Holds in part: 2 of 3 controlled motions")
    assert "hardly depends on the motion" in text
    assert text.endswith("Poses beyond a limit were visited by: the paper's motion.")


def test_verdict_when_no_more_than_half_of_the_runs_end():
    text = "Does not hold: only 1 of 2 controlled motions came to their end (crank_dead_centre)."
    assert verdict(perfect_log(status="failed"), perfect_log())[0] == text
    assert verdict(runs=4)[0] == "Does not hold: only 0 of 4 controlled motions came to their end."


@pytest.mark.parametrize("quick", [True, False])
def test_the_motions_can_be_run_and_the_first_is_the_base(tmp_path, quick):
    study = Study(tmp_path, quick=quick, base=Scenario(duration=2.0))
    motions = controlled_motions(study)
    assert len(motions) >= 4
    name, first = next(iter(motions.items()))
    assert name == "the paper's motion"
    assert first == study.base.replace({"duration": min(2.0, first.duration)})
    for scenario in motions.values():
        check_scenario(scenario)
    others = study.base.replace({"reference.center": [0.0, 0.0, 0.0, 0.0, 0.0, 0.31]})
    assert next(iter(controlled_motions(replace(study, base=others)))) == "the scenario's motion"


def test_motions_keep_half_of_the_room(tmp_path):
    motions = controlled_motions(Study(tmp_path, quick=True))
    reference = motions["Y at 1 Hz"].reference
    assert isinstance(reference, SineReference)
    assert reference.amplitude[4] > 0.05
    twice = tuple(2.05 * a for a in reference.amplitude)
    with pytest.raises(ConfigurationError):
        check_scenario(motions["Y at 1 Hz"].replace({"reference.amplitude": list(twice)}))


def labelled(figure):
    return [axes for axes in figure.axes if axes.get_visible() and axes.get_label() != "<colorbar>"]


def test_figures_have_labelled_axes(study, poses):
    region = visited_region("the paper's motion", perfect_log())
    logs, names = [region.log, perfect_log(scale=15.0)], ["the paper's motion", "strong"]
    slices = slice_surveys(study, poses, "orientation")
    rows = [(kind, losses(poses.surveys[kind]), poses.boundaries[kind].first()) for kind in KINDS]
    figures = [
        plot_slices(slices),
        plot_slices(slice_surveys(study, poses, "position")[:4]),
        plot_capability(slices[2]),
        plot_boundaries([poses.boundaries[kind] for kind in KINDS], ROBOT),
        plot_losses(rows),
        plot_motion_map(motion_slice(study, poses, region.log["reference"]), region.log, region.use),
        plot_state_region(logs, names, poses.ranges),
        plot_torque_region(logs, names, 10.0, 5.0),
    ]
    for figure in figures:
        panels = labelled(figure)
        assert panels
        for axes in panels:
            assert "[" in axes.get_xlabel()
            assert "[" in axes.get_ylabel() or axes.get_xlabel() == "share [%]"


def test_singularities_have_colours_of_their_own(study, poses):
    slices = slice_surveys(study, poses, "orientation")
    colours = {tuple(np.round(c.get_edgecolor()[0], 3)) for c in plot_slices(slices).axes[2].collections}
    assert len(colours) == 3  # edge of the limits, serial, parallel


def test_section_from_end_to_end(report):
    section = report.sections["workspace"]
    numbers = section.numbers
    for kind in KINDS:
        found = numbers["workspaces"][kind]
        assert found["connected"] <= found["feasible"] <= found["spanning"]
        assert found["boundary_volume"] == pytest.approx(found["connected"], rel=0.1) or kind == "orientation"
    paper = numbers["motions"]["the paper's motion"]
    assert paper["status"] == "completed"
    assert paper["reference_torque"] == pytest.approx(visited_region("", perfect_log()).peak_torque, rel=1e-3)
    assert {"ball_swing", "conditioning"} <= set(numbers["workspaces"]["orientation"]["first"])
    assert section.verdict.startswith("Holds")
    assert "a parallel singularity ends some" in section.body
    assert "none ends near a singularity" in section.body


def test_command_writes_the_report_and_its_numbers(tmp_path, report, monkeypatch):
    section = report.sections["workspace"]
    asked = []

    def same_again(study, samples, center):
        asked.append((study.base, samples, center))
        shutil.copytree(report.folder / "figures", study.folder / "figures", dirs_exist_ok=True)
        return section

    monkeypatch.setattr(section_module, "make_section", same_again)
    arguments = ["--out", str(tmp_path / "w"), "--samples", "1000", "--set", "limits.clearance=0.008"]
    pose = [0.1, 0.0, 0.0, 0.0, 0.0, 0.31]
    result = CliRunner().invoke(workspace, [*arguments, "--pose", *map(str, pose)], catch_exceptions=False)
    assert result.exit_code == 0, result.output
    assert "the paper's motion" in result.output
    (base, samples, center) = asked[0]
    assert (base.limits.clearance, samples, center.tolist()) == (0.008, 1000, pose)
    assert json.loads((tmp_path / "w" / "workspace.json").read_text()) == section.numbers
    assert {"report.html", "report.md", "figures"} <= {path.name for path in (tmp_path / "w").iterdir()}
    assert dict(section_module.summary(section.numbers))["torque of the paper's motion"].endswith("completed")


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--pose", "0", "0", "0", "0", "0", "0.7"], "a pose that all rods can reach"),
        (["--pose", "0", "0", "0", "nan", "0", "0.3"], "finite"),
        (["--set", "reference.amplitude=[2, 0, 0, 0, 0, 0]"], "reference"),
        (["--scenario", "no_such_scenario"], "no_such_scenario"),
    ],
)
def test_command_refuses_before_any_work(tmp_path, arguments, message):
    result = CliRunner().invoke(workspace, ["--out", str(tmp_path / "w"), *arguments])
    assert isinstance(result.exception, ConfigurationError)
    assert message in str(result.exception)
    assert not (tmp_path / "w").exists()
