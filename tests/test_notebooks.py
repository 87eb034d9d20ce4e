"""The notebooks run, and what they say of a figure is true of its numbers.

After each cell that draws comes a sentence that says what to see, and then a claim: a cell tagged `claim`, which the
site hides, with asserts on what was drawn.
"""

import ctypes.util
import os
import re
from itertools import pairwise
from pathlib import Path

import nbformat
import pytest
from nbclient import NotebookClient

FOLDER = Path(__file__).parents[1] / "notebooks"
EXERCISES = "exercises"  # of docs/course.md, without answers and pictures
NAMES = (
    *("01_first_steps", "02_robot_and_plant", "03_build_the_diagram"),
    *("04_follow_a_heart", "05_the_tuner", "06_reachy_mini", "07_in_drake"),
    *("paper/1_plant_and_kinematics", "paper/2_force_map", "paper/3_state_space", "paper/4_nine_experiments"),
    EXERCISES,
    *("paper/5_data_and_network", "paper/6_tuner_in_the_loop", "paper/7_sensitivity_and_workspace"),
)
TRAINING = "paper/5_data_and_network"  # all others run without torch
EXACT_GAINS = {
    "study = Reproduction(quick=True)": """study = Reproduction(quick=True)
study.base = study.base.replace({"controller.solver": "split"})"""
}
SHORTER = dict.fromkeys((name for name in NAMES if name.startswith("paper/")), EXACT_GAINS)
CLAIM = {"tags": ["claim", "remove-cell"]}
FILM = "first_steps.gif"
CELL_TIMEOUT = 300  # [s], far above what any cell needs, for busy machines


def read(name):
    notebook = nbformat.read(FOLDER / f"{name}.ipynb", as_version=nbformat.NO_CONVERT)
    nbformat.validate(notebook)
    return notebook


def draws(cell):
    """Whether a cell has a picture in what is kept by an export as HTML, which drops image/gif."""
    kept = [output.get("data", {}) for output in cell.get("outputs", [])]
    return any("image/png" in data or "<img src=" in data.get("text/html", "") for data in kept)


def code_cells(notebook):
    return [cell for cell in notebook.cells if cell.cell_type == "code"]


def numbers(text):
    """Numbers in a text, without signs; those of equations, such as (37), are names."""
    return {float(number) for number in re.findall(r"(?<![\w.])\d+(?:\.\d+)?", re.sub(r"\(\d+\)", "", text))}


def test_every_notebook_is_tested():
    found = {str(path.relative_to(FOLDER).with_suffix("")) for path in FOLDER.rglob("*.ipynb")}
    assert found == set(NAMES)


@pytest.mark.parametrize("name", NAMES)
def test_is_committed_without_outputs_or_traces_of_its_author(name):
    notebook = read(name)
    assert (notebook.nbformat, notebook.nbformat_minor) == (4, 5)
    assert notebook.metadata.kernelspec.name == "python3"
    assert set(notebook.metadata) == {"kernelspec", "language_info"}
    assert set(notebook.metadata.language_info) == {"name"}
    assert all(cell.metadata in ({}, CLAIM) for cell in notebook.cells)
    assert all((cell.outputs, cell.execution_count) == ([], None) for cell in code_cells(notebook))
    assert any("stewart_drake" in cell.source for cell in code_cells(notebook))


@pytest.mark.parametrize("name", [name for name in NAMES if name != EXERCISES])
def test_a_claim_asserts_every_number_of_the_sentence_before_it(name):
    cells = read(name).cells
    claims = [(sentence, cell) for sentence, cell in pairwise(cells) if cell.metadata == CLAIM]
    assert claims
    for sentence, claim in claims:
        assert sentence.cell_type == "markdown"
        assert "\n\n" not in sentence.source
        assert "assert " in claim.source
        assert numbers(sentence.source) <= numbers(claim.source), sentence.source


def test_the_one_that_trains_says_at_its_top_what_installs_torch():
    assert [name for name in NAMES if "pip install 'stewart-drake[train]'" in read(name).cells[0].source] == [TRAINING]


RUNS = [
    pytest.param(
        NAMES[0], marks=pytest.mark.skipif(ctypes.util.find_library("EGL") is None, reason="its film needs libEGL")
    ),
    *(pytest.param(name, marks=[pytest.mark.torch] if name == TRAINING else []) for name in NAMES[1:]),
]


@pytest.mark.long
@pytest.mark.parametrize("name", RUNS)
def test_runs_from_top_to_bottom_and_its_claims_hold(name, tmp_path):
    # The kernel picks its own backend for figures and keeps its history out of the user's home.
    environment = {key: value for key, value in os.environ.items() if key != "MPLBACKEND"}
    environment["IPYTHONDIR"] = str(tmp_path / "ipython")
    notebook = read(name)
    for as_it_is, short in SHORTER.get(name, {}).items():
        (place,) = [cell for cell in code_cells(notebook) if as_it_is in cell.source]
        place.source = place.source.replace(as_it_is, short)

    client = NotebookClient(
        notebook, timeout=CELL_TIMEOUT, kernel_name="python3", resources={"metadata": {"path": str(tmp_path)}}
    )
    client.execute(env=environment)

    outputs = [output for cell in code_cells(notebook) for output in cell.outputs]
    complaints = [o.text for o in outputs if o.get("name") == "stderr" and "warn" in o.text.lower()]
    assert complaints == []
    assert {path.name for path in tmp_path.iterdir()} <= {"ipython", FILM}

    assert not any("image/gif" in output.get("data", {}) for output in outputs)
    drawing = [place for place, cell in enumerate(notebook.cells) if draws(cell)]
    assert drawing or name == EXERCISES
    for place in drawing:
        sentence, claim = notebook.cells[place + 1 : place + 3]
        assert sentence.cell_type == "markdown", notebook.cells[place].source
        assert claim.metadata.get("tags") == CLAIM["tags"], notebook.cells[place].source
