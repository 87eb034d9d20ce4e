import dataclasses
import json
import random
import re

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from made_logs import made_log
from scipy.io import loadmat

from stewart_drake import ConfigurationError, Scenario, load_log, run
from stewart_drake.base.atomic_files import seal
from stewart_drake.base.tables import AXES
from stewart_drake.base.yaml_files import parse_yaml
from stewart_drake.logs.signals import SIGNALS


@pytest.fixture
def log():
    start = made_log(rows=7)
    rng = np.random.default_rng(1)
    signals = {name: rng.normal(size=values.shape) for name, values in start.items()}
    signals["torque"][3] = [np.nan, np.inf, -np.inf, -0.0, 5e-324, 1e308]
    return dataclasses.replace(
        start,
        signals={**signals, "time": start.time},
        status="failed",
        reason="crank_dead_centre",
        message="crank of leg 2 at its dead centre: ü",
        leg=2,
        outcome_time=0.65,
        warnings=({"name": "saturation", "time": 0.5, "number": 0.25, "text": "a quarter"},),
        figures={"rmse_mm": [1.0, None, 2.0], "not_finite": {"rmse_mm.1": "nan"}},
        end_time=0.65,
        versions={"python": "3.11", "drake": None},
        files={"/somewhere/net.json": "ab12", "/gone.csv": None},
    )


@pytest.mark.parametrize("rows", [7, 0])
def test_a_saved_log_loads_back_bit_for_bit_from_its_file_and_from_its_folder(log, tmp_path, rows):
    log = dataclasses.replace(log, signals={name: values[:rows] for name, values in log.items()})
    log.save(tmp_path / "log.parquet")
    for path in (tmp_path / "log.parquet", str(tmp_path)):
        again = load_log(path)
        for name, values in log.items():
            np.testing.assert_array_equal(again[name], values)
            np.testing.assert_array_equal(np.signbit(again[name]), np.signbit(values))
        for field in dataclasses.fields(log):
            if field.name != "signals":
                assert getattr(again, field.name) == getattr(log, field.name), field.name


@pytest.mark.parametrize("rows", [7, 1])
def test_a_log_for_matlab_has_every_signal_with_its_units_under_names_that_matlab_takes(log, tmp_path, rows):
    log = dataclasses.replace(log, signals={name: values[:rows] for name, values in log.items()})
    log.save(tmp_path / "log.mat")
    read = loadmat(tmp_path / "log.mat")
    about = loadmat(tmp_path / "log.mat", simplify_cells=True)
    for name, values in log.items():
        np.testing.assert_array_equal(read[name], values.reshape(rows, -1))
        assert np.size(about["units"][name]) == np.size(about["columns"][name]) == read[name].shape[1]
        assert re.fullmatch("[a-z][a-z0-9_]{0,30}", name)
    assert about["units"]["pose"].tolist() == ["rad", "rad", "rad", "m", "m", "m"]
    assert about["columns"]["pose"].tolist() == [f"pose_{axis}" for axis in AXES]
    assert (about["units"]["time"], about["status"]) == ("s", "failed")
    assert Scenario.from_dict(parse_yaml(about["scenario"], "scenario")) == log.scenario


def test_a_log_saved_as_csv_loads_back_with_the_scenario_that_it_does_not_have(log, tmp_path):
    log.save(tmp_path / "log.csv")
    for scenario in (None, log.scenario):
        again = load_log(tmp_path / "log.csv", scenario)
        assert (list(again), again.state_names) == (list(log), log.state_names)
        for name, values in log.items():
            np.testing.assert_array_equal(again[name], values, err_msg=name)
        assert scenario in (None, again.scenario)
        assert again.status == "unknown"
        assert "does not say how the run ended" in repr(again)


def test_a_log_is_a_mapping_and_shows_itself_in_six_lines(log):
    assert (list(log), len(log)) == (list(SIGNALS), len(SIGNALS))
    with pytest.raises(KeyError, match=r"^log: expected one with the signal pos.*, got 'time, pose, "):
        log["pos"]
    lines = repr(log).splitlines()
    assert len(lines) == 6
    assert "failed, crank_dead_centre at t = 0.650 s" in lines[0]
    assert lines[1].strip() == log.message


def test_columns_have_units_and_parquet_has_frame_text_scenario_and_outcome(log):
    schema = pq.read_schema(pa.BufferReader(log.to_parquet()))
    widths = [1 if values.ndim == 1 else values.shape[1] for values in log.values()]
    assert len(schema.names) == len(set(schema.names)) == sum(widths)
    angles = [f"{axis}_rad" for axis in AXES[:3]]
    lengths = [f"{axis}_m" for axis in AXES[3:]]
    assert schema.names[:7] == ["time_s", *(f"pose_{each}" for each in (*angles, *lengths))]
    expected = {
        "pose_rate_roll_rad_per_s": "rad/s", "reference_acceleration_z_m_per_s2": "m/s^2", "integral_x_m_s": "m s",
        "torque_0_Nm": "N m", "weights_omega_q": "1", "plant_state_motor_0_q_rad": "rad",
    }  # fmt: skip
    assert {name: schema.field(name).metadata[b"unit"].decode() for name in expected} == expected
    assert all(field.metadata[b"text"] and field.type == pa.float64() for field in schema)
    run = json.loads(schema.metadata[b"stewart_drake.run"])
    assert run["scenario"] == log.scenario.to_dict()
    assert (run["outcome"]["reason"], run["outcome"]["leg"]) == ("crank_dead_centre", 2)


def test_what_is_no_log_is_named_in_one_line(log, tmp_path):
    path = tmp_path / "log.parquet"

    def refused(words):
        with pytest.raises(ConfigurationError, match=words) as caught:
            load_log(path)
        assert str(path) in str(caught.value)
        assert str(caught.value).isprintable()

    refused("No such file")
    path.write_bytes(log.to_parquet()[:-1])
    refused("a Parquet file from this version of the package")
    table = pq.read_table(pa.BufferReader(log.to_parquet()))
    run = json.loads(table.schema.metadata[b"stewart_drake.run"])
    del run["checksum"]
    short = table.drop_columns(["pose_x_m"])
    for columns, about, words in (
        (table, seal({**run, "version": 2}), "version 2"),
        (short, seal({**run, "columns": short.column_names}), "no column of pose_x"),
        (short, seal(run), "other columns than were written"),
        (table, seal({**run, "scenario": {"durration": 1}}), "durration"),
        (table, run, "no checksum, as in older versions"),
        (table, {**seal(run), "version": 2}, "its checksum is not that of its content"),
    ):
        pq.write_table(columns.replace_schema_metadata({"stewart_drake.run": json.dumps(about)}), path)
        refused(words)
    with pytest.raises(ConfigurationError, match=r"a name that ends in \.parquet, \.csv, \.mcap or \.mat"):
        log.save(tmp_path / "log.xlsx")


def test_a_flipped_bit_in_the_header_of_a_log_is_refused_or_changes_nothing(log, tmp_path):
    path, content, chance, refused = tmp_path / "log.parquet", log.to_parquet(), random.Random(0), 0
    begin = content.index(b'"version": 4')
    for _ in range(100):
        damaged = bytearray(content)
        damaged[chance.randrange(begin, len(content))] ^= 1 << chance.randrange(8)
        path.write_bytes(damaged)
        try:
            again = load_log(path)
        except ConfigurationError:
            refused += 1
        else:
            assert (again.scenario, again.outcome(), list(again)) == (log.scenario, log.outcome(), list(log))
    assert refused > 50


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda rows: [f"{row},{'time_ms' if row[0] == 't' else 7}" for row in rows], "got 'time_s, time_ms'"),
        (
            lambda rows: [rows[0].replace("pose_roll_rad", "pose_roll_m"), *rows[1:]],
            "one of pose_roll_rad, pose_roll_deg",
        ),
        (lambda rows: [rows[0], rows[2], rows[1]], "row 2, time: expected a time after that of the row before"),
        (lambda rows: [rows[0], rows[1], rows[1]], "row 2, time: expected a time after that of the row before"),
    ],
    ids=["two times", "another unit", "back", "twice"],
)
def test_a_table_that_contradicts_itself_is_no_log(log, tmp_path, change, words):
    path = tmp_path / "log.csv"
    path.write_text("\n".join(change(log.to_csv().decode().splitlines()[:3])) + "\n")
    with pytest.raises(ConfigurationError, match=words):
        load_log(path)


def test_a_log_becomes_a_frame(log):
    np.testing.assert_array_equal(log.to_pandas()["pose_x_m"], log["pose"][:, 3])


def test_a_log_names_the_tuner_where_the_controller_listens_to_it():
    fast = {"plant.kind": "closed_form", "duration": 0.05}
    logs = [run(Scenario().replace({**fast, "controller": kind})) for kind in ("lqi", "computed_torque")]
    assert "controller lqi, tuner paper," in repr(logs[0])
    assert "tuner: paper" in repr(logs[0].scenario)
    assert "tuner paper" not in repr(logs[1])
    assert "tuner: none" in repr(logs[1].scenario)
