import numpy as np
import pytest

from geoaim.base.errors import RegistrationError
from geoaim.base.geometry import translation
from geoaim.mapping.registration.ambiguity import MOVING_PART
from geoaim.mapping.registration.frame_registration import FrameRegistration
from geoaim.mapping.registration.sequence import check_ground, find_jumps

SIZE = (540, 960)
NONE = np.full((3, 3), np.nan)


def make_registered(found, rival=None):
    """A frame displaced by `found` px, of which a part is displaced by `rival` px."""
    other = None if rival is None else translation(rival, 0)
    return FrameRegistration(translation(found, 0), "", 0.9, 0.9, 0.02, other)


def make_rejected(reason):
    return FrameRegistration(NONE, reason, 0.0, 0.0, np.inf)


def drift(step, count=8):
    return 20.0 + step * np.arange(count)


def test_vehicles_may_move_more_than_the_ground():
    check_ground(map(make_registered, drift(1), drift(5)), SIZE)


def test_a_sequence_that_moves_more_than_the_rest_of_the_image_is_refused():
    with pytest.raises(RegistrationError, match="moves less than the one that was registered, 7"):
        check_ground(map(make_registered, drift(5), drift(1)), SIZE)


def test_steps_are_equal_that_a_small_image_does_not_tell_apart():
    check_ground(map(make_registered, drift(8), drift(5.5)), SIZE)


def test_an_overlay_at_rest_is_not_the_ground():
    check_ground(map(make_registered, drift(5), drift(0) - 20), SIZE)


def test_a_sequence_in_which_nothing_else_moves_is_the_ground():
    check_ground(map(make_registered, drift(5)), SIZE)


@pytest.mark.parametrize(("reason", "refused"), [(MOVING_PART, True), ("too few inliers", False)])
def test_a_sequence_that_is_mostly_ambiguous_is_refused(reason, refused):
    frames = [*map(make_registered, drift(1, 3)), *[make_rejected(f"{reason}: 20 %")] * 4]
    if not refused:
        check_ground(frames, SIZE)
        return
    with pytest.raises(RegistrationError, match=r"in 4 of 7 frames.* \(--fixed-camera\)"):
        check_ground(frames, SIZE)


def test_a_camera_that_stands_may_see_traffic_in_most_frames():
    check_ground([make_registered(0.0)] * 3 + [make_rejected(MOVING_PART)] * 4, SIZE)


def test_few_frames_are_not_judged_together():
    check_ground([make_rejected(MOVING_PART)] * 4, SIZE)


def test_a_frame_far_from_neighbours_that_agree_has_jumped():
    places = np.array([translation(80.0 if x == 6 else float(x), 0) for x in range(13)])
    assert np.flatnonzero(find_jumps(places, SIZE)).tolist() == [6]


def test_a_single_shorter_step_may_be_chance():
    frames = [
        make_registered(20.0, 25.0),
        make_registered(40.0, 27.0),
        *map(make_registered, drift(1)),
    ]
    check_ground(frames, SIZE)
