import numpy as np
import pytest

from calcidem.dem.wave.recorder import WaveRecord


@pytest.mark.parametrize(("stride", "time_step"), [(1, 1e-7), (8, 1.3e-7), (125, 7e-9)])
def test_samples_are_taken_in_the_middle_of_every_last_step(stride: int, time_step: float) -> None:
    """Leapfrog velocities belong to half a step before the end of the step after which they are read."""
    signal = np.zeros(40)
    record = WaveRecord(time_step, stride, signal, signal, signal, stability_limit=2.0 * time_step, steps=40 * stride)
    assert record.start_time == pytest.approx(record.sampling_interval - time_step / 2.0)
    assert record.times == pytest.approx(record.start_time + np.arange(40) * record.sampling_interval)
    assert record.duration == pytest.approx(record.times[-1] + time_step / 2.0)
