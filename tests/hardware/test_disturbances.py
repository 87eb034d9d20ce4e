import numpy as np
import pytest

from stewart_drake.base.sampling import on_grid
from stewart_drake.hardware.disturbances import ImpulseWrench, NoiseWrench, StepWrench

WRENCH = (0.1, -0.2, 0.3, 4.0, -5.0, 6.0)


def test_a_step_begins_and_ends_at_its_times():
    step = StepWrench(wrench=WRENCH, time=0.3, until=0.7)
    for time, on in ((0.2999, False), (0.3, True), (0.6999, True), (0.7, False)):
        np.testing.assert_array_equal(step.evaluate(time), np.array(WRENCH) * on)
    np.testing.assert_array_equal(StepWrench(wrench=WRENCH, time=0.3).evaluate(1e6), WRENCH)


@pytest.mark.parametrize(("step", "time"), [(0.001, 0.0), (0.0005, 0.625), (0.005, 7.1)])
def test_the_plants_steps_take_an_impulse_in_full(step, time):
    blow = ImpulseWrench(impulse=WRENCH, time=time, duration=0.01)
    samples = np.arange(round(10.0 / step)) * on_grid(step)
    np.testing.assert_allclose(blow.evaluate(samples).sum(axis=0) * step, WRENCH, rtol=1e-9)


@pytest.mark.slow
def test_noise_has_its_size_and_its_band_and_independent_axes():
    rms = (0.1, 0.2, 0.3, 1.0, 2.0, 3.0)
    noise = NoiseWrench(rms=rms, low=5.0, high=20.0, seed=1)
    step = 0.002
    values = noise.evaluate(np.arange(0.0, 200.0, step))
    np.testing.assert_allclose(values.std(axis=0), rms, rtol=0.05)
    power = np.abs(np.fft.rfft(values[:, 3])) ** 2
    frequency = np.fft.rfftfreq(len(values), step)
    inside = (frequency > 4.9) & (frequency < 20.1)
    assert power[inside].sum() > 0.999 * power.sum()
    assert power[frequency < 12.5].sum() / power.sum() == pytest.approx(0.5, abs=0.03)
    assert np.abs(np.corrcoef(values.T) - np.eye(6)).max() < 0.1
