import csv
import dataclasses
import json
import sys
from dataclasses import replace

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from made_logs import STATES, made_log, sealed

from stewart_drake.errors import ConfigurationError
from stewart_drake.logs.log import AXIS_NAMES, SIGNALS, SimulationLog, load_log
from stewart_drake.plant.multibody_plant import build_plant
from stewart_drake.robot import RobotParameters


@pytest.fixture
def log():
    """Every entry of every signal differs from every other."""
    start = made_log(rows=7)
    rng = np.random.default_rng(1)
    signals = {name: rng.normal(size=values.shape) for name, values in start.signals.items()}
    signals["time"] = start.time
    return dataclasses.replace(
        start,
        signals=signals,
        status="failed",
        reason="crank_dead_centre",
        message="crank of leg 2 at its dead centre: ü",
        leg=2,
        outcome_time=0.65,
        warnings=({"name": "saturation", "time": 0.5, "number": 0.25, "text": "a quarter"},),
        figures={"rmse_mm": [1.0, None, 2.0], "events": {"level": 0}, "not_finite": {"rmse_mm.1": "nan"}},
        end_time=0.65,
        versions={"python": "3.11", "drake": None},
        files={"/somewhere/net.json": "ab12", "/gone.csv": None},
    )


@pytest.mark.parametrize("rows", [7, 0])
def test_a_saved_log_loads_back_bit_for_bit_from_its_file_and_from_its_folder(log, tmp_path, rows):
    log = replace(log, signals={name: values[:rows] for name, values in log.signals.items()})
    log.save(tmp_path / "log.parquet")
    for path in (tmp_path / "log.parquet", str(tmp_path)):
        again = load_log(path)
        assert isinstance(again, SimulationLog)
        assert list(again.signals) == list(SIGNALS)
        for name, values in log.signals.items():
            np.testing.assert_array_equal(again[name], values)
            assert again[name].shape == values.shape
        for field in dataclasses.fields(log):
            if field.name != "signals":
                assert getattr(again, field.name) == getattr(log, field.name), field.name
    with pytest.raises(KeyError, match="pos; this log has time, pose, "):
        again["pos"]


def test_numbers_that_are_not_finite_survive(tmp_path):
    torque = np.array([[np.nan, np.inf, -np.inf, -0.0, 5e-324, 1e308]])
    made_log(rows=1, torque=torque).save(tmp_path / "log.parquet")
    again = load_log(tmp_path / "log.parquet")["torque"]
    np.testing.assert_array_equal(again, torque)
    assert np.signbit(again[0, 3])


def test_every_column_tells_its_unit_frame_and_meaning(log):
    schema = pq.read_schema(pa.BufferReader(log.to_parquet()))
    units = {field.name: field.metadata[b"unit"].decode() for field in schema}
    frames = {field.name: field.metadata[b"frame"].decode() for field in schema}
    widths = [1 if values.ndim == 1 else values.shape[1] for values in log.signals.values()]
    assert len(schema.names) == len(set(schema.names)) == sum(widths)
    states = [name for name in schema.names if name.startswith("plant_state.")]
    assert states == [f"plant_state.state {i}" for i in range(STATES)]
    # Other programs can read scenario and outcome too.
    run = json.loads(schema.metadata[b"stewart_drake.run"])
    assert run["scenario"] == log.scenario.to_dict()
    assert (run["outcome"]["reason"], run["outcome"]["leg"]) == ("crank_dead_centre", 2)
    assert all(field.metadata[b"text"] for field in schema)
    assert all(field.type == pa.float64() for field in schema)
    assert units["time"] == "s"
    assert [units[f"pose.{axis}"] for axis in AXIS_NAMES] == ["rad"] * 3 + ["m"] * 3
    assert [units[f"pose_rate.{axis}"] for axis in AXIS_NAMES] == ["rad/s"] * 3 + ["m/s"] * 3
    assert [units[f"integral.{axis}"] for axis in AXIS_NAMES] == ["rad s"] * 3 + ["m s"] * 3
    assert [units[f"torque.{leg}"] for leg in range(6)] == ["N m"] * 6
    assert units["loop_gap.0"] == "m"
    assert frames["pose.x"] == "P in B"
    assert frames["torque.3"] == "about the motor axis"


def with_run(run, table=None):
    return sealed(b"stewart_drake.run", pa.table({"time": [0.0]}) if table is None else table, run)


def unsealed(metadata):
    stream = pa.BufferOutputStream()
    pq.write_table(pa.table({"time": [0.0]}).replace_schema_metadata(metadata), stream)
    return stream.getvalue().to_pybytes()


@pytest.mark.parametrize(
    ("content", "words"),
    [
        (None, "No such file"),
        (b"", "a Parquet file"),
        (b"time,pose\n0,0\n" * 100, "a Parquet file"),
        (made_log(rows=2).to_parquet()[:-1], "a Parquet file"),
        (unsealed({}), "one written by this package"),
        (unsealed({"stewart_drake.run": "{}"}), "a checksum that is not that of its content"),
        (with_run({"version": 1}), "version 2"),
        (with_run([1]), "metadata that cannot be read"),
        (with_run({"version": 2}), "metadata that cannot be read"),
    ],
    ids=range(9),
)
def test_what_is_no_log_is_named_in_one_line(tmp_path, content, words):
    path = tmp_path / "log.parquet"
    if content is not None:
        path.write_bytes(content)
    for place in (path, tmp_path):
        with pytest.raises(ConfigurationError) as caught:
            load_log(place)
        assert str(path) in str(caught.value)
        assert words in str(caught.value)
        assert str(caught.value).isprintable()


def parts_of(log):
    table = pq.read_table(pa.BufferReader(log.to_parquet()))
    return json.loads(table.schema.metadata[b"stewart_drake.run"]), table


def test_of_a_long_log_every_so_many_rows_can_be_read(log, tmp_path):
    log.save(tmp_path / "log.parquet")
    for most, every in {1: 7, 3: 3, 7: 1, 8: 1}.items():
        again = load_log(tmp_path, most_rows=most)
        assert len(again.time) <= most
        for name, values in log.signals.items():
            np.testing.assert_array_equal(again[name], values[::every])


def test_entries_of_the_plants_state_have_their_own_units():
    names = build_plant(RobotParameters())[1].state_names
    columns = dataclasses.replace(made_log(rows=2), state_names=names).columns()
    units = {"motor_0_q": "rad", "universal_3_wy": "rad/s", "platform_qw": "1", "platform_z": "m"}
    for name, unit in (units | {"platform_wx": "rad/s", "platform_vy": "m/s"}).items():
        assert columns[f"plant_state.{name}"][1] == unit


def test_a_log_that_has_lost_a_column_or_has_a_scenario_that_is_not_allowed_is_refused(log, tmp_path):
    run, table = parts_of(log)
    path = tmp_path / "log.parquet"
    for column in ("time", "pose.x", "plant_state.state 1"):
        path.write_bytes(with_run(run, table.drop_columns([column])))
        with pytest.raises(ConfigurationError, match=f"no column {column}"):
            load_log(path)
    run["scenario"]["durration"] = 1
    path.write_bytes(with_run(run, table))
    with pytest.raises(ConfigurationError, match="durration"):
        load_log(path)


def test_a_log_shows_itself_in_five_lines(log):
    lines = repr(log).splitlines()
    assert len(lines) == 5
    assert max(map(len, lines)) < 300
    assert "failed, crank_dead_centre at t = 0.650 s" in lines[0]
    assert "saturation" in lines[4]


def test_the_ending_of_the_name_is_the_format(log, tmp_path):
    log.save(tmp_path / "log.csv")
    with (tmp_path / "log.csv").open() as stream:
        rows = list(csv.reader(stream))
    assert rows[0] == log.table().column_names
    np.testing.assert_array_equal(np.array(rows[1:], dtype=float)[:, 0], log.time)
    for name in ("log", "log.xlsx", "log.parquet.gz", "parquet"):
        with pytest.raises(ConfigurationError, match=r"a name that ends in \.parquet or \.csv"):
            log.save(tmp_path / name)
    assert [path.name for path in tmp_path.iterdir()] == ["log.csv"]


def test_a_log_becomes_a_frame_of_pandas_and_without_pandas_the_remedy_is_named(log, monkeypatch):
    monkeypatch.setitem(sys.modules, "pandas", None)
    with pytest.raises(ConfigurationError, match="pip install pandas"):
        log.to_pandas()
    monkeypatch.undo()
    pandas = pytest.importorskip("pandas")
    frame = log.to_pandas()
    assert isinstance(frame, pandas.DataFrame)
    np.testing.assert_array_equal(frame["pose.x"], log["pose"][:, 3])


@pytest.mark.slow
def test_a_flipped_bit_anywhere_is_refused(log, tmp_path):
    content, rng = log.to_parquet(), np.random.default_rng(0)
    path = tmp_path / "log.parquet"
    for place in rng.integers(0, len(content), 150):
        spoilt = bytearray(content)
        spoilt[place] ^= 1 << rng.integers(8)
        path.write_bytes(spoilt)
        with pytest.raises(ConfigurationError) as caught:
            load_log(path)
        assert "\n" not in str(caught.value)
