import json
import shutil
from dataclasses import replace

import numpy as np
import pytest
from click.testing import CliRunner
from strategies import ROBOT

from stewart_drake.cli.workspace_command import workspace
from stewart_drake.errors import ConfigurationError
from stewart_drake.paper import workspace_section as section_module
from stewart_drake.paper.pose_study import KINDS, motion_slice, slice_surveys, survey_poses
from stewart_drake.paper.study import Study
from stewart_drake.paper.visited_region import controlled_motions
from stewart_drake.paper.workspace_section import sizes
from stewart_drake.planning.limits import Limits
from stewart_drake.planning.measures import measure_poses
from stewart_drake.planning.workspace import COORDINATES, poses_at, utilisation
from stewart_drake.references import SineReference, paper_reference
from stewart_drake.runs.simulation import check_scenario
from stewart_drake.scenario import Scenario


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
    found = motion_slice(study, poses, paper_reference().evaluate(np.linspace(0.0, 3.2, 161))[0])
    moving = [c for c, n in zip(found.grid.coordinates, found.grid.counts, strict=True) if n > 1]
    assert moving == [0, 5]
    still = motion_slice(study, poses, np.tile(ROBOT.home_pose, (5, 1)))
    assert [c for c, n in zip(still.grid.coordinates, still.grid.counts, strict=True) if n > 1] == [0, 5]


def test_the_motions_can_be_run_and_the_first_is_the_base(tmp_path):
    study = Study(tmp_path, base=Scenario(duration=2.0))
    motions = controlled_motions(study)
    assert len(motions) == 7
    name, first = next(iter(motions.items()))
    assert name == "the paper's motion"
    assert first == study.base.replace({"duration": min(2.0, first.duration)})
    for scenario in motions.values():
        check_scenario(scenario)
    others = study.base.replace({"reference.amplitude": [0.2, 0.0, 0.0, 0.0, 0.0, 0.02]})
    assert next(iter(controlled_motions(replace(study, base=others)))) == "the scenario's motion"


def test_motions_keep_half_of_the_room(tmp_path):
    motions = controlled_motions(Study(tmp_path, quick=True))
    reference = motions["Y at 1 Hz"].reference
    assert isinstance(reference, SineReference)
    assert reference.amplitude[4] > 0.05
    twice = tuple(2.05 * a for a in reference.amplitude)
    with pytest.raises(ConfigurationError):
        check_scenario(motions["Y at 1 Hz"].replace({"reference.amplitude": list(twice)}))


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
        (["--scenario", "no_such_scenario"], "no_such_scenario"),
    ],
)
def test_command_refuses_before_any_work(tmp_path, arguments, message):
    result = CliRunner().invoke(workspace, ["--out", str(tmp_path / "w"), *arguments])
    assert isinstance(result.exception, ConfigurationError)
    assert message in str(result.exception)
    assert not (tmp_path / "w").exists()
