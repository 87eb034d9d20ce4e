"""The commands `moves check`, `moves fix` and `moves export`."""

import json

import numpy as np
import pytest

from stewart_drake.references.moves import HEAD_HEIGHT, Move, move_json, read_move


@pytest.fixture
def folder(tmp_path):
    """A jump that cannot be done, and a nod that can."""
    time, where = 0.01 * np.arange(150), tmp_path / "given"
    where.mkdir()
    for name, pitch in (("nod", 0.2 * np.sin(5.0 * time)), ("jump", np.where(time < 0.7, 0.0, 0.3))):
        pose = np.tile([0.0, 0.0, 0.0, 0.0, 0.0, HEAD_HEIGHT], (150, 1))
        pose[:, 1] = pitch
        (where / f"{name}.json").write_bytes(move_json(Move(name, time, pose, np.zeros((150, 2)), np.zeros(150))))
    return where


def test_moves_are_checked_fixed_and_shaped(call, folder):
    status, out, err = call("moves", "check", "given", "--json")
    assert (status, err) == (2, "stewart-drake: 1 of 2 cannot be done; try: stewart-drake moves fix given\n")
    found = json.loads(out)
    assert (found["nod"]["feasible"], found["jump"]["feasible"]) == (True, False)
    assert found["jump"]["torque"]["margin"] < 0.0 <= found["nod"]["torque"]["margin"]
    assert found["jump"]["torque"]["time"] == pytest.approx(0.7, abs=0.05)
    assert "broken" in call("moves", "check", folder / "jump.json")[1]
    status, out, err = call("moves", "fix", "given", "--out", "fixed")
    assert (status, err) == (0, "")
    assert "averaged ms" in out
    assert out.endswith("2 moves in fixed\n")
    assert call("moves", "check", "fixed")[0] == 0
    assert call("moves", "export", "fixed", "--shaped", "reachy_daemon", "--out", "shaped")[0] == 0
    assert len(read_move("shaped/nod.json").time) == 76  # rows at the controller's 50 Hz
    assert call("moves", "export", "given/nod.json", "--out", "same")[0] == 0
    np.testing.assert_allclose(read_move("same/nod.json").pose, read_move("given/nod.json").pose, atol=1e-14)


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        ("check nowhere.json", "No such file"),
        ("check given/nod.json --shaped x", "No such option"),
        ("export given/nod.json --shaped reachy_nod", "motors that take angles"),
        ("fix given/nod.json --out given/nod.json", "is a file"),
    ],
)
@pytest.mark.usefixtures("folder")
def test_what_is_wrong_is_a_line(call, arguments, said):
    status, _, err = call("moves", *arguments.split())
    assert status == 2
    assert said in err
    assert len(err.splitlines()) == 1
