import json
from pathlib import Path

import cv2
import numpy as np
import pytest

import geoaim
from benchmarks.detection.judging import judge
from benchmarks.detection.scenes import draw_scene
from benchmarks.detection.stills import Still
from geoaim.base.errors import GeoaimError
from geoaim.detection import detect_vehicles, network, propose_scale, write_detections
from geoaim.detection.network import MODEL, Peaks, decode, find_peaks
from geoaim.detection.vehicles import get_probabilities, resample, to_logit

RESOLUTION = 0.14  # finer than the network's: pictures are reduced


def draw(seed, pixels=320, resolution=RESOLUTION):
    return draw_scene(pixels, resolution, np.random.default_rng(seed))


@pytest.fixture(scope="module")
def scenes():
    return [draw(seed) for seed in range(900, 908)]


def find(image, resolution=RESOLUTION):
    boxes = detect_vehicles(image, resolution)
    corners = boxes.get_corners()
    middles = corners.mean(axis=1)
    along = corners[:, 1] - corners[:, 0]
    width = np.linalg.norm(corners[:, 2] - corners[:, 1], axis=1)
    return middles, along, np.linalg.norm(along, axis=1), width


def match(scenes):
    """Pairs of drawn vehicles in the open and what was found within a metre, and the counts."""
    pairs, drawn, found = [], 0, 0
    for image, truth, hidden in scenes:
        middles, along, length, width = find(image)
        inner = ((middles > 15) & (middles < 305)).all(1)
        found += inner.sum()
        open_ = (hidden < 0.3) & ((truth[:, :2] > 15) & (truth[:, :2] < 305)).all(1)
        drawn += open_.sum()
        for u, v, heading, long, wide in truth[open_]:
            far = np.hypot(*(middles - [u, v]).T)
            if len(far) and far.min() * RESOLUTION < 1:
                k = int(far.argmin())
                pairs.append((heading, along[k], long, length[k], wide, width[k]))
    return pairs, drawn, found


def test_most_vehicles_of_drawn_places_are_found(scenes):
    pairs, drawn, found = match(scenes)
    assert drawn > 80
    assert len(pairs) > 0.75 * drawn  # some lie in shadow or are half hidden
    assert len(pairs) > 0.8 * found


def test_boxes_have_the_line_and_the_size_of_the_vehicles(scenes):
    pairs, *_ = match(scenes)
    across = [
        abs(np.cross([*a, 0], [np.cos(h), np.sin(h), 0])[2]) / np.hypot(*a) for h, a, *_ in pairs
    ]
    assert np.median(across) < np.sin(np.radians(4))
    sizes = np.array([pair[2:] for pair in pairs], float)
    assert abs(np.log(sizes[:, 1] / sizes[:, 0])).mean() < 0.12
    assert abs(np.log(sizes[:, 3] / sizes[:, 2])).mean() < 0.12


def test_corners_begin_at_the_rear(scenes):
    pairs, *_ = match(scenes)
    ahead = [a @ [np.cos(h), np.sin(h)] > 0 for h, a, *_ in pairs]
    assert np.mean(ahead) > 0.7


def test_boxes_are_in_pixels_of_the_picture(scenes):
    image, *_ = scenes[0]
    large = cv2.resize(image, None, fx=2, fy=2, interpolation=cv2.INTER_NEAREST)
    one, other = find(image)[0], find(large, RESOLUTION / 2)[0] / 2
    near = [np.hypot(*(other - middle).T).min() for middle in one]
    assert np.median(near) < 0.5


def test_scores_are_log_odds_on_a_line():
    peaks = Peaks(np.zeros((3, 2)), *np.zeros((3, 3)), np.array([-2.0, to_logit(0.5), 4.0]))
    low, half, high = get_probabilities(peaks)
    assert half == pytest.approx(0.5)
    assert low < half < high


def test_a_large_picture_is_searched_in_tiles(scenes, monkeypatch):
    image = np.vstack([np.hstack([s[0] for s in scenes[k : k + 4]]) for k in (0, 4)])
    small = resample(image, RESOLUTION)
    whole = find_peaks(small, 0.0)
    monkeypatch.setattr(network, "TILE", 400)
    tiles = find_peaks(small, 0.0)
    assert len(tiles.centres) == pytest.approx(len(whole.centres), abs=2)
    near = [np.hypot(*(whole.centres - middle).T).min() for middle in tiles.centres]
    assert np.median(near) < 0.5


def test_neighbours_in_the_output_become_vehicles_of_their_own():
    output = np.zeros((9, 8, 12), np.float32)
    output[0] = -9
    output[0, 3, 3], output[0, 3, 5], output[0, 3, 4] = 2, 3, 1  # 2.2 m apart, side by side
    output[5] = -1  # upright
    found = decode(output, 0.0)
    assert found.centres.tolist() == [[14, 14], [22, 14]]
    assert np.abs(found.headings).tolist() == pytest.approx([np.pi / 2, np.pi / 2])
    assert (found.lengths * network.RESOLUTION).tolist() == pytest.approx([4.5, 4.5])


@pytest.mark.parametrize(
    ("image", "said"),
    [
        (np.zeros((9, 9), np.uint8), r"shape \(9, 9\)"),
        (np.zeros((9, 9, 3), np.float32), "float32"),
        (np.zeros((9, 9, 4), np.uint8), r"shape \(9, 9, 4\)"),
    ],
)
def test_what_is_no_picture_is_refused(image, said):
    with pytest.raises(GeoaimError, match=said):
        detect_vehicles(image, 0.1)


def test_a_scale_must_be_positive():
    with pytest.raises(ValueError, match="resolution is 0"):
        detect_vehicles(np.zeros((9, 9, 3), np.uint8), 0)


@pytest.mark.parametrize("true", [0.13, 0.25])
def test_the_scale_is_proposed_by_cars(true):
    images = [draw(seed, int(80 / true), true)[0] for seed in (900, 902, 905)]
    scale = propose_scale(images)
    assert scale.resolution == pytest.approx(true, rel=0.12)
    assert 0.03 < scale.sigma < 0.15


def test_without_cars_no_scale_is_proposed():
    with pytest.raises(GeoaimError, match="--frame-resolution"):
        propose_scale([np.full((200, 300, 3), 120, np.uint8)])


def test_what_is_written_is_read_again(scenes, tmp_path):
    images = [scene[0] for scene in scenes[:2]]
    found = geoaim.detect(images, resolution=RESOLUTION)
    video = geoaim.open_video(images)
    for name in ("boxes.csv", "boxes"):
        write_detections(found, tmp_path / name)
        read = geoaim.read_detections(tmp_path / name, video=video)
        for frame in video:
            own, again = found(frame), read(frame)
            assert len(again.boxes) == len(own.boxes) > 3
            turns = np.abs(again.get_corners().mean(1) - own.get_corners().mean(1))
            assert turns.max() < 0.01
            assert again.get_scores() == pytest.approx(own.get_scores(), abs=0.001)


def test_one_picture_is_a_video_of_one_frame(scenes):
    assert list(geoaim.detect(scenes[0][0], resolution=RESOLUTION).boxes) == [0]


def test_the_network_is_small_and_needs_no_pickle():
    assert MODEL.stat().st_size < 2e6
    assert set(json.loads(MODEL.with_suffix(".json").read_text())) == {"calibration"}
    assert {path.suffix for path in MODEL.parent.iterdir()} == {".onnx", ".json", ".md", ""}


def test_judging_counts_what_is_right_wrong_and_missed():
    boxes = np.array([[100, 100, 140, 120], [200, 100, 240, 120], [20, 300, 60, 320.0]])
    ignored = np.array([False, False, True])
    still = Still(np.zeros((400, 400, 3), np.uint8), 0.1, boxes, ignored, "made")
    centres = np.array([[121, 111], [122, 112], [300, 300], [41, 311.0]])
    size = np.full(4, 40.0), np.full(4, 20.0)
    judged = judge(still, Peaks(centres, np.zeros(4), *size, np.array([3.0, 2, 1, 4])))
    assert judged.labelled == 2
    assert judged.right.tolist() == [True, False, False]
    assert judged.get_rates(0.5) == (0.5, pytest.approx(1 / 3))


def test_command_writes_boxes_that_track_reads(tmp_path, scenes):
    from typer.testing import CliRunner

    from geoaim.cli import app

    picture = tmp_path / "one.png"
    cv2.imwrite(str(picture), scenes[0][0][..., ::-1])
    output = tmp_path / "boxes.csv"
    arguments = ["detect", str(picture), "-o", str(output), "--frame-resolution", str(RESOLUTION)]
    result = CliRunner().invoke(app, arguments)
    assert result.exit_code == 0, result.output
    assert len(Path(output).read_text().splitlines()) > 3
