"""Parts for themselves: what a tick reads and writes, when it is due, and how it ends."""

from typing import ClassVar

import numpy as np
import pytest

from stewart_drake import Scenario, build_diagram
from stewart_drake.base.errors import ConfigurationError, RunFailure
from stewart_drake.base.records import Record, Vec2, Vec12
from stewart_drake.loop.part import HEALTHY, BoundPart, LoopRunner, Part
from stewart_drake.scenario.assembly import loop_of
from stewart_drake.scenario.stepped_loop import SteppedLoop


class Sum(Record):
    total: Vec2


class SumWithHealth(Sum):
    health: Vec2


class Gain(Record):
    size: float


def add(gain, term, state):
    state["total"][0] += gain["size"][0] * term


def adder(name="adder", term="term", **changes):
    gain = Gain.new(size=2.0)
    part = Part(name, add, {}, {"term": 2}, ("total",), Sum.new(), connections={"term": term}, **changes)
    return part._replace(parameters={"gain": gain})


def runner(*parts, **options):
    made = LoopRunner(parts, {"term": 2, "size": 1}, **options)
    made.signal("term")[:] = 1.0, 10.0
    return made


def test_a_tick_by_hand_changes_the_state_in_place():
    state = Sum.new()
    for _ in range(2):
        adder().tick(np.array([1.0, 10.0]), state)
    np.testing.assert_array_equal(state["total"][0], [4.0, 40.0])


def test_an_input_is_of_this_instant_from_a_part_before_and_of_the_tick_before_from_one_after():
    first, second = adder("first").named(total="one"), adder("second", "one").named(total="two")
    forward, backward = runner(first, second), runner(second, first)
    for loop in (forward, backward):
        loop.run()
    np.testing.assert_array_equal(forward.signal("two"), [4.0, 40.0])
    np.testing.assert_array_equal(backward.signal("two"), [0.0, 0.0])


def test_a_part_runs_at_the_steps_of_its_period_and_at_the_end_if_it_says_so():
    slow, late = adder("slow", period=0.003).named(total="slow"), adder("late", end_of_tick=True).named(total="late")
    loop = runner(adder(), slow, late, period=0.002, step=0.001)
    counts = []
    for step in range(7):
        loop.run(step)
        counts.append([loop.signal(name)[0] / 2.0 for name in ("total", "slow", "late")])
        loop.end(step)
    np.testing.assert_array_equal(
        counts, np.transpose([[1, 1, 2, 2, 3, 3, 4], [1, 1, 1, 2, 2, 2, 3], [0, 1, 1, 2, 2, 3, 3]])
    )


def test_a_period_between_two_steps_is_refused():
    with pytest.raises(ConfigurationError, match=r"^adder\.period: expected a whole multiple"):
        runner(adder(period=0.0025), step=0.001)


def test_a_signal_takes_the_place_of_a_parameter_of_its_size():
    loop = runner(adder().connected(gain="size"))
    loop.signal("size")[:] = 5.0
    loop.run()
    np.testing.assert_array_equal(loop.signal("total"), [5.0, 50.0])
    with pytest.raises(ConfigurationError, match=r"^adder\.gain: expected a signal of 1 numbers of float64, got '2 of"):
        runner(adder().connected(gain="term"))


def test_what_is_run_does_not_write_to_the_parameters_of_its_part():
    part = adder()
    bound = BoundPart(part, [np.ones(2)], part.initial.copy())
    bound.arguments[0]["size"] = 7.0
    assert part.parameters["gain"]["size"] == 2.0


def fail(reading, state):
    state["total"][0] += reading
    return int(reading[0] < 0.0), 3


def failing(**changes):
    def error(result, arguments):
        return RunFailure(f"reading {arguments['reading'][0]:g}", leg=result[1])

    state, outputs = (SumWithHealth, ("total", "health")) if changes else (Sum, ("total",))
    return Part("watch", fail, {}, {"reading": 2}, outputs, state.new(), error=error, **changes)


def test_a_failed_tick_raises_the_named_error_with_the_time():
    loop = LoopRunner([failing()], {"reading": 2})
    loop.signal("reading")[:], loop.time[0] = -1.0, 0.25
    with pytest.raises(RunFailure, match=r"reading -1") as caught:
        loop.run()
    assert (caught.value.leg, caught.value.time) == (3, 0.25)


def test_a_failed_tick_of_a_tolerant_part_repeats_its_state_and_reports_why_until_one_succeeds():
    loop = LoopRunner([failing(fault_tolerant=True)], {"reading": 2})
    for reading, total, leg in ((2.0, 2.0, -1.0), (-1.0, 2.0, 3.0), (1.0, 3.0, -1.0)):
        loop.signal("reading")[:] = reading
        loop.run()
        assert (loop.signal("total")[0], loop.signal("health")[1]) == (total, leg)
        assert (loop.signal("health")[0] == HEALTHY[0]) == (reading > 0.0)


def test_a_copy_of_the_values_is_a_snapshot_and_another_loop_goes_on_from_what_both_have():
    loop, other = runner(adder(), adder("more").named(total="more")), runner(adder())
    loop.run()
    kept = loop.values.copy()
    other.take_over(loop)
    for runner_ in (loop, other):
        runner_.run()
    np.testing.assert_array_equal(loop.signal("total"), other.signal("total"))
    loop.values[:] = kept
    np.testing.assert_array_equal(loop.signal("total"), [2.0, 20.0])
    loop.reset()
    np.testing.assert_array_equal(loop.state("more")["total"][0], [0.0, 0.0])


def test_a_raised_failure_of_a_users_kernel_is_that_of_a_status():
    def stop(_, __):
        raise RunFailure("no more")

    part = Part("own", stop, {}, {"reading": 2}, ("health",), SumWithHealth.new(), fault_tolerant=True)
    state = part.initial.copy()
    BoundPart(part, [np.zeros(2)], state)()
    assert state["health"][0, 0] != HEALTHY[0]


class Elsewhere:
    """A user's sensor; what is wrong is set in the tests."""

    inputs: ClassVar = {"plant_pose": 12}
    outputs: ClassVar = ("reading",)

    def parts(self, _):
        return (Part("mine", print, {}, self.inputs, self.outputs, Pose.new()),)


class Pose(Record):
    reading: Vec12
    other: Vec12


@pytest.mark.parametrize(
    ("outputs", "text"),
    [(("other",), "parts without the output reading"), (("lost",), "an output lost of mine, which is not a field")],
)
def test_parts_of_a_user_that_give_something_else_are_refused(monkeypatch, outputs, text):
    monkeypatch.setattr(Elsewhere, "outputs", outputs)
    with pytest.raises(ConfigurationError, match=rf"^sensors\.kind: .*{text}"):
        loop_of(Scenario(sensors=Elsewhere))


@pytest.mark.parametrize(("engine", "plant"), [(build_diagram, "drake"), (SteppedLoop, "closed_form")])
def test_an_input_that_no_part_gives_is_refused(monkeypatch, engine, plant):
    monkeypatch.setattr(Elsewhere, "inputs", {"plant_poze": 12})
    with pytest.raises(ConfigurationError, match=r"^mine\.plant_poze: expected a signal of the loop: .* plant_pose, "):
        engine(Scenario(sensors=Elsewhere, tuner="fixed", plant=plant))
