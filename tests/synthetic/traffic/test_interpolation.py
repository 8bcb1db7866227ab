import numpy as np
import pytest

from geoaim.synthetic.traffic.interpolation import interpolate_tracks


def test_times_outside_the_recording_are_refused(recorded):
    sample, _ = recorded
    recording = sample.recordings[0]
    times = recording.times[-1] + np.arange(3.0)
    with pytest.raises(ValueError, match="the recording is from 0 to 120 s"):
        interpolate_tracks(sample.traffic_model, recording, sample.place, times=times)


def test_margin_keeps_agents_outside_the_extent(recorded):
    sample, tracks = recorded
    given = sample.traffic_model, sample.recordings[0], sample.place
    wide = interpolate_tracks(*given, times=tracks.times, margin=10.0)
    assert wide.present.sum() > tracks.present.sum()
    assert set(tracks.ids) <= set(wide.ids)
