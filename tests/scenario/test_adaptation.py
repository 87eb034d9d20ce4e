"""A law that learns while the robot runs: its outputs take the places of parameters of other parts."""

from typing import ClassVar, Literal

import numpy as np
import pytest

from stewart_drake import Controller, load_scenario, run
from stewart_drake.base.config import Positive
from stewart_drake.base.errors import ConfigurationError
from stewart_drake.base.registry import ADAPTATIONS
from stewart_drake.control.base import AdaptationOptions
from stewart_drake.control.friction_compensation import FrictionCompensation
from stewart_drake.loop.part import Part
from stewart_drake.mechanics.kinematics import crank_rates, inverse_kinematics, leg_geometry


class FrictionLearner(AdaptationOptions):
    """Dry friction of each motor grows where its crank lags behind the reference."""

    kind: Literal["friction_learner"] = "friction_learner"
    gain: Positive = 400.0
    """[N m/(rad s)]"""
    output: str = "friction"

    def parts(self, context):
        believed = FrictionCompensation(width=0.01).part(context).parameters["friction"]
        state = np.zeros(1, [(self.output, believed.dtype)])
        state[self.output] = believed
        constants = {"model": context.robot, "gain": self.gain * context.period, "name": self.output}
        return (Part("learner", learn, constants, {"measurement": 12, "reference": 18}, (self.output,), state),)


def learn(model, gain, name, measurement, reference, state):
    legs = leg_geometry(model, reference[:6])
    rates = crank_rates(model, legs, reference[:6], reference[6:12])
    lag = legs.crank_angles - inverse_kinematics(model, measurement[:6])
    more = gain * lag * np.tanh(rates / 0.01)
    for level in ("coulomb", "break_away"):
        state[name][level] += more


@pytest.fixture
def scenario(monkeypatch):
    monkeypatch.setattr(ADAPTATIONS, "_lines", {})
    ADAPTATIONS.add(FrictionLearner)
    slow = {"kind": "sine", "amplitude": [0.05, 0.04, 0.03, 0.002, 0.003, 0.004], "angular_frequency": 6.0}
    return load_scenario("exact_fig7").replace(
        {
            **{"plant": {"kind": "closed_form", "motor_friction": 0.05}, "reference": slow, "duration": 4.0},
            **{"controller": {"kind": "pid"}, "model.friction": {"width": 0.01}, "safety": None},
        }
    )


def late_error(log):
    return np.sqrt(np.mean(log["error"][log.time > 3.0] ** 2))


def test_what_is_learnt_takes_the_place_of_what_was_believed(scenario):
    unaware, learns = run(scenario), run(scenario.replace({"adaptation": "friction_learner"}))
    told = run(scenario.replace({"model.friction.coulomb": 0.05}))
    assert late_error(learns) < 0.5 * late_error(unaware)
    assert late_error(learns) < 2.0 * late_error(told)


def test_it_learns_the_same_beside_a_machine(scenario):
    scenario = scenario.replace({"adaptation": "friction_learner", "duration": 0.3})
    log = run(scenario)
    beside, out = Controller(scenario.control()), np.empty(6)
    for tick in range(100):
        beside.step(np.concatenate([log["pose"][tick], log["pose_rate"][tick]]), log.time[tick], out)
        np.testing.assert_array_equal(out, log["torque"][tick])


def test_an_output_that_no_parameter_is_for_is_refused(scenario):
    with pytest.raises(ConfigurationError, match=r"^adaptation\.kind: expected one that writes .*controller\.robot"):
        run(scenario.replace({"adaptation": {"kind": "friction_learner", "output": "masses"}}))
    # The motors of this loop take torques: nobody asks for their gain.
    with pytest.raises(ConfigurationError, match=r"^adaptation\.kind: expected one that writes .*controller\.robot"):
        run(scenario.replace({"adaptation": {"kind": "friction_learner", "output": "gain"}}))


class Listed(FrictionLearner):
    kind: Literal["listed"] = "listed"
    writes: ClassVar = {
        "named": ("friction_compensation.friction",),
        "misspelt": ("friction_compensation.frictoin",),
        "too_long": ("friction_compensation.joints",),
        "elsewhere": ("observer.friction", "friction_compensation.friction"),
    }


def test_what_a_law_writes_is_what_it_lists_if_name_and_size_match(scenario):
    ADAPTATIONS.add(Listed)
    scenario = scenario.replace({"duration": 0.1})

    def learning(output):
        return run(scenario.replace({"adaptation": {"kind": "listed", "output": output}}))["torque"]

    for output in ("named", "elsewhere"):
        np.testing.assert_array_equal(
            learning(output), run(scenario.replace({"adaptation": "friction_learner"}))["torque"]
        )
    misspelt = r"^adaptation\.writes\.misspelt: expected .*friction_compensation\.friction.* got '.*\.frictoin'"
    with pytest.raises(ConfigurationError, match=misspelt):
        learning("misspelt")
    with pytest.raises(ConfigurationError, match=r"^friction_compensation\.joints: expected a signal of \d+ numbers"):
        learning("too_long")
