"""The quick report, made once for the session: what holds of every section, and what each one's numbers must show."""

import itertools
import json
import re
from collections import Counter
from html.parser import HTMLParser

import numpy as np
import pytest
from jinja2 import nodes
from matplotlib.image import imread

from stewart_drake.control.network import load_network
from stewart_drake.paper.departures_section import departures
from stewart_drake.paper.experiments import RATIOS
from stewart_drake.paper.rendering import environment
from stewart_drake.paper.reproduce import SECTIONS
from stewart_drake.paper.training_section import best_possible_scores
from stewart_drake.training.dataset import load_dataset
from stewart_drake.training.train import TrainingOptions, r_squared, split_samples


class Links(HTMLParser):
    def __init__(self, page):
        super().__init__()
        self.sources, self.targets, self.ids = [], [], []
        self.feed(page)

    def handle_starttag(self, _, attrs):
        values = dict(attrs)
        self.sources += [values[name] for name in ("src", "srcset", "data") if name in values]
        self.targets += [values[name] for name in ("href",) if name in values]
        self.ids += [values[name] for name in ("id",) if name in values]


# --- every section ---------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("key", SECTIONS)
def test_a_section_is_whole_and_its_pictures_are_drawn(report, key):
    section, markdown = report.sections[key], (report.folder / "report.md").read_text()
    document = json.loads((report.folder / "report.json").read_text(), parse_constant=pytest.fail)
    assert section.numbers == document["numbers"][key] != {}
    for words in (section.title, section.claim, section.verdict, section.body):
        assert words
        assert words in markdown
    # Quick, every claim comes out as it does whole.
    assert re.match(r"(Holds|Holds in part|Does not hold|Neither)\b", section.verdict), section.verdict
    assert not re.search(r"\b(nan|None(?! of)|inf|undefined)\b|\{[{%]", section.verdict + section.body)
    for before, block in itertools.pairwise(section.body.split("\n\n")):
        assert not block.startswith("| ") or re.fullmatch(r"\*.+\*", before), "a table without its caption"
    # Every picture that a section made is shown in it, and the other way round.
    shown = re.findall(r"\(<figures/([^>]+)>\)", section.body)
    assert sorted(f"figures/{name}" for name in shown) == sorted(n for n in section.files if n.startswith("figures/"))
    for name in section.files:
        assert (report.folder / name).stat().st_size > 0
    for name in shown:
        pixels = imread(report.folder / "figures" / name)
        assert min(pixels.shape[:2]) > 200
        assert 0.01 < (pixels[..., :3] < 0.9).any(axis=-1).mean() < 0.95, f"{name} is blank"


@pytest.mark.parametrize("key", SECTIONS)
def test_every_number_that_a_template_speaks_of_exists(report, key):
    source = environment().loader.get_source(environment(), f"{key}.md.j2")[0]
    asked = environment().parse(source).find_all(nodes.Getattr)
    names = {found.attr for found in asked if isinstance(found.node, nodes.Name) and found.node.name == "n"}
    assert names
    assert names - set(report.sections[key].numbers) == set()


def test_the_report_holds_every_section_and_each_picture_once(report):
    document = json.loads((report.folder / "report.json").read_text())
    assert list(document["numbers"]) == list(SECTIONS)
    markdown, links = (report.folder / "report.md").read_text(), Links((report.folder / "report.html").read_text())
    shown = re.findall(r"\(<figures/([^>]+)>\)", markdown)
    assert len(shown) == len(set(shown)) >= 10
    assert {path.name for path in (report.folder / "figures").iterdir()} == set(shown)
    for where, _, _, places in departures():
        # A section that is named for an equation speaks of it.
        for equation in re.findall(r"^\(\d+\)", where):
            named = [s for s in report.sections.values() if s.title.split(":")[0] in places]
            assert [s.key for s in named if equation not in s.body] == []
    assert len(links.sources) == len(shown)
    assert all(source.startswith("data:image/png;base64,") for source in links.sources)
    inside = {f"#{name}" for name in links.ids}
    assert len(links.ids) == len(SECTIONS)
    assert inside <= set(links.targets)
    assert all(target in inside or target.startswith("https://") for target in links.targets)


def test_its_progress_rises_from_zero_to_one_within_each_section(report):
    shares = [share for _, share in report.progress]
    assert shares == sorted(shares)
    assert (shares[0], shares[-1]) == (0.0, 1.0)
    counts = Counter(key for key, _ in report.progress)
    # From the start to the end of each, and on the way where it takes time.
    assert min(counts.values()) >= 2
    assert all(counts[key] > 2 for key in set(SECTIONS) - {"departures"})


# --- what each must show ---------------------------------------------------------------------------------------------


def plant(n):
    np.testing.assert_allclose(n["orders"], 1.0, atol=0.1)
    np.testing.assert_allclose(n["gap_orders"], 2.0, atol=0.2)
    assert n["position_error"][-1] < n["position_error"][0]


def kinematics(n):
    assert max(row["rod_error"] for row in n["inverse"].values()) < 1e-14
    assert n["forward"]["near -1 home"]["same"] == n["regions"]["near"]["poses"]
    assert n["forward"]["wide -1 home"]["other_across"] > 0
    assert 0.04 < n["regions"]["announced"]["share"] < 0.09
    assert 100.0 < 1e3 * n["misprints"]["(5)"]["joint_shift"][0] < 140.0
    assert 1e3 * n["misprints"]["(3)"]["joint_shift"][2] < 8.0


def force_map(n):
    assert n["rod_force"]["statics_error"][1] < 1e-3
    assert n["rod_force"]["printed_error"][1] > 0.1
    assert n["exact_model_error"] < 1e-4
    assert n["models"]["massless legs"]["massless legs"][2] < 1e-3
    assert min(row[1] for row in n["models"]["Table I"].values()) > 0.3
    assert n["ratio"]["near"][1] == pytest.approx(0.88, abs=0.02)


def state_space(n):
    assert n["matrices_as_printed"] == {"A": True, "B": True, "C": True}
    assert n["hautus"]["detectability"] == 18
    assert all(row["full"] == row["poses"] for row in n["hautus"]["regions"].values())
    kinds = {row["axis"]: row["kind"] for row in n["hautus"]["singular"]}
    assert kinds["+roll"] == kinds["-yaw"] == "parallel"
    assert kinds["-X"] == kinds["+Z"] == "serial"
    radius = {row["ratio"]: row["radius"] for row in n["tau_for_m_inverse_tau"]["rows"]}
    assert radius[0.01] < 1.0 < radius[1.0]
    assert n["riccati"]["sizes_fit"] is False
    assert n["riccati"]["undiscretised_gain"] < 1e-12
    assert n["riccati"]["radius_34"] < 1.0 < n["riccati"]["radius_30"]
    assert n["riccati"]["doubling"] == pytest.approx(0.005 * np.log(2.0) / np.log(n["riccati"]["radius_30"]))
    decay = {row["ratio"]: row for row in n["decay"]["rows"]}
    assert decay[0.01]["home"] == pytest.approx(0.662, abs=2e-3)
    assert 0.5 < decay[0.01]["least"] < decay[0.01]["most"] < 0.8
    assert decay[100.0]["most"] == pytest.approx(0.866, abs=1e-3)
    assert decay[100.0]["faster"] > 3.0


def nine_experiments(n):
    assert n["near_zero_at_5s"] >= 5
    assert n["lost_uncompensated"] > 0
    assert n["controllers"] == 5
    assert n["trajectory_spread_same_ratio"] < 1e-9 < 1e-5 < n["trajectory_spread_next_ratio"]
    assert n["gain_spread"] < 1e-10 < 1e-2 < n["gain_spread_next_ratio"]


def dataset(n):
    assert (n["distinct"], n["samples"]) == (5, 9 * 640)
    assert n["equal_ratio_spread"] < 1e-6 < 1e-2 < n["next_ratio_spread"]


def training(n):
    assert n["validation"] == n["scores"]["magnitude samples"]["validation"]
    assert n["best_possible"] == pytest.approx({"omega_Q": 0.5, "omega_R": 0.5, "ratio": 1.0})
    assert n["repeatable"] is True
    assert 0.0 <= n["rounding_of_training"] < 1e-3


def in_the_loop(n):
    assert n["incomplete"] == []
    # Who knows the best of the nine cannot be beaten by one that stays within them.
    for found in n["pose_rmse_mm"].values():
        assert found["oracle"] == min(found[f"ratio {ratio:g}"] for ratio in RATIOS) <= found["mean of the nine"]


def workspace(n):
    for kind in ("position", "orientation"):
        found = n["workspaces"][kind]
        assert found["connected"] <= found["feasible"] <= found["spanning"]
        assert found["boundary_volume"] == pytest.approx(found["connected"], rel=0.1) or kind == "orientation"
    assert n["motions"]["the paper's motion"]["status"] == "completed"
    assert {"ball_swing", "conditioning"} <= set(n["workspaces"]["orientation"]["first"])


WORDS = {
    "kinematics": "Holds in part",
    "force_map": "Does not hold",
    "state_space": "Holds in part: (28) has rank 18 at every regular pose tried and falls, down to 12, at singular",
    "workspace": "Holds",
}


@pytest.mark.parametrize(
    "facts",
    [plant, kinematics, force_map, state_space, nine_experiments, dataset, training, in_the_loop, workspace],
    ids=lambda facts: facts.__name__,
)
def test_the_numbers_show_what_they_should(report, facts):
    section = report.sections[facts.__name__]
    facts(section.numbers)
    assert section.verdict.startswith(WORDS.get(facts.__name__, ""))


def test_the_data_and_the_network_that_the_report_leaves_are_those_of_its_numbers(report):
    data = load_dataset(report.folder / "dataset-quick.parquet")
    assert data.digest() == report.sections["dataset"].numbers["sha256"]
    section, network = report.sections["training"], load_network(report.folder / "tuner-quick.json")
    lines = (line.strip("| ").split(" | ") for line in section.body.split("\n"))
    rows = {tuple(cells[:3]): cells[3:] for cells in lines if len(cells) == 8}
    names = ("omega_Q", "omega_R", "ratio")
    for split, side in itertools.product(("samples", "runs"), ("training", "validation")):
        mask = split_samples(data, TrainingOptions(epochs=300, split=split)) == (side == "training")
        scores = section.numbers["scores"][f"magnitude {split}"][side]
        if split == "samples":
            answers, labels = (np.log10(x) @ [1.0, -1.0] for x in (network.weights(data.inputs), data.outputs))
            # The answers are held within the range of the labels, the score is of the answers before.
            assert scores["ratio"] == pytest.approx(r_squared(labels[mask], answers[mask]), abs=0.02)
        q, q_bound, r, r_bound, ratio = map(float, rows["magnitude", split, side])
        assert [q, r, ratio] == pytest.approx([scores[name] for name in names], rel=1e-3)
        bound = best_possible_scores(data.outputs[mask])
        assert [q_bound, r_bound] == pytest.approx([bound["omega_Q"], bound["omega_R"]], rel=1e-3)


def test_what_is_said_of_the_workspace_follows_its_limits(report):
    body = report.sections["workspace"].body
    assert "a parallel singularity ends some" in body
    assert "none ends near a singularity" in body
