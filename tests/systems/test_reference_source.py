import numpy as np
import pytest
from pydrake.systems.analysis import Simulator

from stewart_drake.references import HoldReference, SineBurstsReference, paper_reference
from stewart_drake.systems.reference_source import ReferenceSource

AMPLITUDE = (0.1, 0.05, 0.05, 0.01, 0.01, 0.02)
REFERENCES = [
    HoldReference(pose=(0.1, 0.2, 0.3, 0.01, 0.02, 0.3)),
    paper_reference(),
    SineBurstsReference(frequency=(1.0, 3.0), amplitude=(AMPLITUDE, AMPLITUDE)),
]


@pytest.mark.parametrize("reference", REFERENCES, ids=lambda r: r.kind)
def test_it_gives_pose_rate_and_acceleration_at_the_contexts_time(reference):
    system = ReferenceSource(reference)
    context = system.CreateDefaultContext()
    for time in (0.0, 0.3, 1.7, 0.3):  # back in time too: nothing stale in the cache
        context.SetTime(time)
        pose, rate, acceleration = reference.evaluate(time)
        np.testing.assert_array_equal(system.reference.Eval(context), [*pose, *rate, *acceleration])


def test_it_has_no_state_and_no_events():
    system = ReferenceSource(paper_reference())
    context = system.CreateDefaultContext()
    assert context.num_total_states() == 0
    simulator = Simulator(system, context)
    simulator.AdvanceTo(2.0)
    assert simulator.get_num_steps_taken() <= 21  # of its own, the Simulator steps by 0.1 s
