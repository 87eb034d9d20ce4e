"""What every reference must keep to, with its own derivatives as the only witnesses."""

import numpy as np


def differences(reference, time, h=1e-4):
    """Rate and acceleration (6,) by central differences of fourth order."""
    weight = np.array([1.0, -8.0, 8.0, -1.0]) / (12.0 * h)
    pose, rate, _ = reference.evaluate(time + h * np.array([-2.0, -1.0, 1.0, 2.0]))
    return weight @ (pose - pose[0]), weight @ (rate - rate[0])


def check_derivatives(reference, time, h=1e-4, rtol=1e-7):
    """Rate and acceleration are the derivatives of the pose, where no piece of the motion ends within 2 h of `time`."""
    _, rates, accelerations = reference.evaluate(time + np.linspace(-0.05, 0.05, 41))
    _, rate, acceleration = reference.evaluate(time)
    by_differences = differences(reference, time, h)
    np.testing.assert_allclose(by_differences[0], rate, atol=1e-10 + rtol * np.abs(rates).max())
    np.testing.assert_allclose(by_differences[1], acceleration, atol=1e-10 + rtol * np.abs(accelerations).max())


def check_means(reference, time, width=1e-4):
    """The mean slope over a short time lies between the least and the largest derivative in it; ends of pieces too."""
    pose, rate, acceleration = reference.evaluate(time + width * np.linspace(0.0, 1.0, 21))
    for values, slopes in ((pose, rate), (rate, acceleration)):
        mean = (values[-1] - values[0]) / width
        # Between two of the samples a slope may turn.
        slack = 1e-9 + np.abs(np.diff(slopes, axis=0)).max(axis=0)
        assert np.all(mean >= slopes.min(axis=0) - slack)
        assert np.all(mean <= slopes.max(axis=0) + slack)


def check_smooth(reference, times, jerk):
    """Pose, rate and acceleration do not jump at these times."""
    step = 1e-7
    before, after = (reference.evaluate(np.asarray(times) + side) for side in (-step, step))
    for earlier, later in zip(before, after, strict=True):
        np.testing.assert_allclose(later, earlier, atol=4.0 * step * jerk + 1e-12)


def check_shapes(reference, times):
    """Many times at once give what each gives alone, and a caller may write into what it gets."""
    together = reference.evaluate(np.array([times, times]))
    for index, time in enumerate(times):
        for values, one in zip(together, reference.evaluate(time), strict=True):
            assert values.shape == (2, len(times), 6)
            np.testing.assert_allclose(values[1, index], one, rtol=1e-9, atol=1e-9)
    kept = [values.copy() for values in together]
    for values in together:
        values += 1.0
    for values, again in zip(kept, reference.evaluate(np.array([times, times])), strict=True):
        np.testing.assert_array_equal(values, again)
