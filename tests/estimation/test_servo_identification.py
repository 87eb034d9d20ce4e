"""Servos from commands and angles alone: what comes out, what is told apart, and logs that cannot be used."""

import dataclasses
import json

import numpy as np
import pytest
from recordings import motion
from servo_identification_study import GUESS, NOMINAL, Hidden, hidden, scenario

from stewart_drake import ConfigurationError, ServoRecording, identify_servos, load_scenario, run
from stewart_drake.estimation.servos import (
    COULOMB,
    DAMPING,
    DELAY,
    MASS,
    PARAMETERS,
    ROTOR,
    STIFFNESS,
    load_servo_recording,
    take_angles,
)

REFERENCE = motion(GUESS, size=2.0).to_dict()
FADED = {"kind": "adjusted", "fade_in": 2.0, "motion": REFERENCE}


def played(real: Hidden, seconds: float = 20.0):
    return run(scenario(real, NOMINAL, FADED, seconds), check=False)


@pytest.fixture(scope="module")
def trial():
    real = hidden(1)
    log = played(real)
    return real, log, load_servo_recording(log)


@pytest.fixture(scope="module")
def found(trial):
    real, log, _ = trial
    return identify_servos(GUESS, [log], reading_age=real.age)


def test_hidden_constants_are_within_their_intervals(trial, found):
    off = np.abs(found.values - trial[0].values)
    estimated = found.half_width > 0.0
    assert estimated.sum() == len(PARAMETERS) - 1
    assert (off[~estimated] == 0.0).all()
    share = off[estimated] / found.half_width[estimated]
    assert share.max() < 3.0
    assert (share < 1.0).mean() > 0.6
    width = found.half_width
    assert (width[STIFFNESS] < 0.05 * found.values[STIFFNESS]).all()
    assert width[MASS] < 0.03 * GUESS.platform_mass
    assert width[DELAY] < 1e-3
    assert width[DAMPING].max() < 2e-3
    assert width[COULOMB].max() < 1e-3


def test_only_the_sum_of_reading_age_and_delay_is_identified(trial, found):
    real, _, recording = trial
    other = identify_servos(GUESS, [recording], reading_age=0.0)
    assert other.values[DELAY] == pytest.approx(found.values[DELAY] + real.age, abs=1e-4)
    np.testing.assert_allclose(other.values[STIFFNESS], found.values[STIFFNESS], rtol=0.01)


@pytest.mark.long
def test_a_head_of_known_mass_gives_the_rotors_inertia(trial):
    real, _, recording = trial
    off = GUESS.replace(rotor_inertia=1.3 * GUESS.rotor_inertia, platform_mass=real.robot.platform_mass)
    result = identify_servos(off, [recording], hold=["platform_mass"], reading_age=real.age)
    assert result.values[ROTOR] == pytest.approx(GUESS.rotor_inertia, rel=0.03)
    np.testing.assert_allclose(result.values[STIFFNESS], real.stiffness, rtol=0.03)
    assert (result.values[MASS], result.half_width[MASS]) == (pytest.approx(real.robot.platform_mass), 0.0)
    assert "stiffness" in refused(recording, hold=["stiffness"])


def test_what_was_identified_goes_into_a_scenario(trial, found, tmp_path):
    real, log, _ = trial
    (tmp_path / "mine.yaml").write_text(found.robot_file())
    (tmp_path / "run.yaml").write_text(f"robot: mine.yaml\nmotors: {json.dumps(found.motors)}")
    assert load_scenario(tmp_path / "run.yaml").robot.platform_mass == pytest.approx(found.values[MASS])
    (tmp_path / "run.yaml").write_text(f"robot: mine.yaml\nmotors: {{kind: position}}\n{found.model_file()}")
    belief = load_scenario(tmp_path / "run.yaml").controller_model
    np.testing.assert_allclose(belief.motors.gains, found.values[STIFFNESS])
    total = belief.motors.damping + np.array(belief.friction.viscous)
    np.testing.assert_allclose(total, found.values[DAMPING])
    np.testing.assert_allclose(belief.friction.coulomb, found.values[COULOMB])
    believed = {"robot": found.robot, "motors": found.motors, "friction": found.friction}

    def error(log):
        return np.sqrt(np.mean((log["pose"] - log["reference"])[log.time > 1.0] ** 2, axis=0))

    after = run(scenario(real, believed, FADED, 6.0), check=False)
    assert (error(after) < 0.2 * error(log)).all()


def refused(log, **options):
    """The line."""
    with pytest.raises(ConfigurationError) as caught:
        identify_servos(GUESS, [log], **options)
    assert len(str(caught.value).splitlines()) == 1
    return str(caught.value)


def test_logs_that_cannot_be_used(trial):
    _, log, recording = trial

    def changed(**changes):
        return dataclasses.replace(recording, **changes)

    short = slice(0, 100)
    rows = {name: getattr(recording, name)[short] for name in ("time", "angles", "commands")}
    assert "s of motion" in refused(changed(**rows))
    noise = 1e-3 * np.random.default_rng(0).integers(-1, 2, recording.angles.shape)
    at_rest = changed(angles=recording.angles[0] + noise)
    assert "motor 0 at rest or reversing" in refused(at_rest)
    told = refused(changed(commands=recording.commands[::-1].copy()))
    assert "that no servo explains" in told
    assert told.endswith("--keep-model head.yaml")
    assert "reading_ages" in refused(recording, hold=["reading_ages"])
    with pytest.raises(ConfigurationError, match="at least one log"):
        identify_servos(GUESS, [])
    # Commands twice as far from the angles as these servos can push: the head falls.
    limited = scenario(trial[0], NOMINAL, FADED, 20.0).replace({"motors.torque_limit": 0.05})
    assert "angles at which the robot cannot be assembled" in refused(run(limited, check=False))
    torque = dataclasses.replace(log, scenario=load_scenario("reachy_nod"))
    assert "expected a log of motors that take angles" in refused(torque)
    for name in ("angles", "commands"):
        still = {name: np.repeat(getattr(recording, name)[:1], len(recording), axis=0)}
        with pytest.raises(ConfigurationError, match="the same in all rows"):
            changed(**still)
    with pytest.raises(ConfigurationError, match="radians within"):
        changed(commands=np.degrees(recording.commands))


def test_a_table_of_commands_and_angles(trial, tmp_path):
    recording = trial[2]
    text = recording.to_csv()
    (tmp_path / "log.csv").write_text(text)
    assert take_angles([tmp_path / "log.csv"])
    again = load_servo_recording(tmp_path / "log.csv")
    assert isinstance(again, ServoRecording)
    np.testing.assert_allclose(again.commands, recording.commands, rtol=0.0, atol=1e-12)
    (tmp_path / "without.csv").write_text("\n".join(",".join(row.split(",")[:7]) for row in text.splitlines()))
    with pytest.raises(ConfigurationError, match="commanded_angle_0_rad to commanded_angle_5_rad"):
        take_angles([tmp_path / "without.csv"])


def test_a_few_lost_ticks_are_filled_in_and_more_are_refused():
    time = 0.02 * np.arange(200)
    angles = 0.3 * np.sin(2.0 * time[:, None] + np.arange(6))
    commands = np.repeat(angles[::4], 4, axis=0)
    kept = np.delete(np.arange(200), [50, 51, 120])
    filled = ServoRecording(time[kept], angles[kept], commands[kept])
    np.testing.assert_allclose(filled.time, time, atol=1e-12)
    np.testing.assert_allclose(filled.angles, angles, atol=2e-3)
    np.testing.assert_array_equal(filled.commands[[50, 51]], commands[[49, 49]])
    few = np.delete(np.arange(200), np.arange(50, 60))
    with pytest.raises(ConfigurationError, match="without gaps"):
        ServoRecording(time[few], angles[few], commands[few])
