import dataclasses
import json

import numpy as np
import pyarrow as pa
import pyarrow.parquet as pq
import pytest
from made_logs import made_log

from stewart_drake.errors import ConfigurationError
from stewart_drake.files.tables import to_parquet, with_about
from stewart_drake.logs.log import AXIS_NAMES, SIGNALS, load_log
from stewart_drake.runs.simulation import run
from stewart_drake.scenario import Scenario


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
    with pytest.raises(KeyError, match=r"pos.*; this log has time, pose, "):
        log["pos"]
    lines = repr(log).splitlines()
    assert len(lines) == 6
    assert "failed, crank_dead_centre at t = 0.650 s" in lines[0]
    assert lines[1].strip() == log.message


def test_columns_say_their_units_and_parquet_has_frame_text_scenario_and_outcome(log):
    schema = pq.read_schema(pa.BufferReader(log.to_parquet()))
    widths = [1 if values.ndim == 1 else values.shape[1] for values in log.values()]
    assert len(schema.names) == len(set(schema.names)) == sum(widths)
    angles = [f"{axis}_rad" for axis in AXIS_NAMES[:3]]
    lengths = [f"{axis}_m" for axis in AXIS_NAMES[3:]]
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
    for columns, about, words in (
        (table, {**run, "version": 2}, "version 2"),
        (table.drop_columns(["pose_x_m"]), run, "no column of pose_x"),
        (table, {**run, "scenario": {"durration": 1}}, "durration"),
    ):
        path.write_bytes(to_parquet(with_about(columns.replace_schema_metadata(), "run", about)))
        refused(words)
    with pytest.raises(ConfigurationError, match=r"a name that ends in \.parquet or \.csv"):
        log.save(tmp_path / "log.xlsx")


def test_a_log_becomes_a_frame_a_dataset_with_named_axes_and_a_cell_of_a_notebook(log):
    np.testing.assert_array_equal(log.to_pandas()["pose_x_m"], log["pose"][:, 3])
    dataset = log.to_xarray()
    np.testing.assert_array_equal(dataset["pose"].sel(axis="z"), log["pose"][:, 5])
    assert (dataset["time"].attrs["units"], dataset["pose"].attrs["units"][5]) == ("s", "m")
    assert log._repr_html_().count("<polyline") == 2


def test_a_log_names_the_tuner_where_the_controller_listens_to_it():
    fast = {"plant.engine": "reduced", "duration": 0.05}
    logs = [run(Scenario().replace({**fast, "controller": kind})) for kind in ("lqi", "computed_torque")]
    assert "controller lqi, tuner paper," in repr(logs[0])
    assert "tuner: paper" in repr(logs[0].scenario)
    assert "tuner paper" not in repr(logs[1])
    assert "tuner: none" in repr(logs[1].scenario)
