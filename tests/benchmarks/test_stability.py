import cv2
import numpy as np
import pandas as pd
import pytest

from benchmarks.registration.stability import benchmark, charts, clips, judge, sweep
from benchmarks.registration.stability.effects import EFFECTS, apply_effects
from benchmarks.registration.stability.kinds import KINDS, Disturbance
from benchmarks.registration.stability.motion import draw_motion
from geoaim.base.progress import no_progress

SMALL = (180, 320)


@pytest.fixture(autouse=True)
def no_real_data(monkeypatch):
    monkeypatch.delenv("GEOAIM_DATA", raising=False)


def make_case(kind, level, *, generator="splines", seed=4):
    base = "town" if generator == "splines" else "junction"
    return clips.SweepCase(kind, 0, level, generator, base, SMALL, seed)


@pytest.fixture
def still(monkeypatch):
    """A drawn base without the cost of a drawn place."""
    noise = np.random.default_rng(0).standard_normal((900, 1600)).astype(np.float32)
    grey = 110 + 400 * cv2.GaussianBlur(noise, (0, 0), 4)
    monkeypatch.setattr(clips, "_read_still", lambda base: grey.clip(0, 255).astype(np.uint8))


def list_effects():
    return sorted({name for kind in KINDS.values() for name, _ in kind.make(0.5).effects})


@pytest.mark.parametrize("generator", ["warped", "splines"])
def test_frames_show_the_ground_where_the_truth_says(still, generator):
    clip = clips.make_clip(make_case("rotation", 10.0, generator=generator), count=4)
    truth = clip.find_truth(0, 3)
    matrix, _ = cv2.findHomography(truth - 0.5, clips.make_check_points(SMALL) - 0.5)
    first, last = (cv2.GaussianBlur(clip.frames[i], (0, 0), 1).astype(float) for i in (0, 3))
    back = cv2.warpPerspective(last, matrix, SMALL[::-1], flags=cv2.INTER_CUBIC | 16)
    inside = slice(60, 120), slice(100, 220)
    assert np.median(np.abs(back[inside] - first[inside])) < 3
    assert np.median(np.abs(last[inside] - first[inside])) > 6


@pytest.mark.parametrize("generator", ["warped", "splines"])
@pytest.mark.parametrize("kind", ["lens", "rolling shutter", "torn frame"])
def test_truth_of_a_frame_in_itself_is_the_identity(still, generator, kind):
    clip = clips.make_clip(make_case(kind, 0.05, generator=generator), count=3)
    np.testing.assert_allclose(clip.find_truth(2, 2), clips.make_check_points(SMALL), atol=1e-6)


@pytest.mark.slow
@pytest.mark.parametrize("generator", ["warped", "splines"])
@pytest.mark.parametrize("kind", [kind for kind in KINDS if ", and" not in kind])
def test_every_kind_is_rendered_by_both_generators(still, generator, kind):
    level = KINDS[kind].levels[1]
    clip = clips.make_clip(make_case(kind, level, generator=generator), count=3)
    assert len(clip.frames) == len(clip.shown) >= 3
    assert all(frame.shape[:2] == SMALL and frame.dtype == np.uint8 for frame in clip.frames)
    assert np.isfinite(clip.find_truth(0, len(clip.frames) - 1)).all()


@pytest.mark.parametrize("name", [name for name in list_effects() if name in EFFECTS])
def test_effects_change_frames_and_keep_their_number(name):
    frames = [np.random.default_rng(i).integers(0, 255, SMALL).astype(np.uint8) for i in range(3)]
    level = {"jpeg": 20, "dust": 40, "gain": 2, "blur": 4}.get(name, 0.8)
    changed, shown = apply_effects(frames, ((name, level),), seed=1)
    assert shown == [0, 1, 2]
    assert any((a.shape != b.shape) or (a != b).any() for a, b in zip(changed, frames, strict=True))


def test_motion_starts_at_the_plain_view_and_reaches_the_level():
    generator = np.random.default_rng(0)
    motion = draw_motion(Disturbance(rotation=90, scale=2.0), 9, 960, generator)
    np.testing.assert_allclose(motion.shift[0], 0, atol=1e-9)
    assert abs(motion.angle[0]) < 1e-9
    assert abs(abs(np.rad2deg(motion.angle[-1])) - 90) < 2
    assert motion.scale[-1] == pytest.approx(2.0, rel=0.02)


def test_splits_share_no_seed_and_no_base():
    cases = {split: list(clips.list_cases(split, ["plain"])) for split in ("validation", "test")}
    assert {case.seed for case in cases["validation"]}.isdisjoint(
        case.seed for case in cases["test"]
    )
    bases = [{(base, real) for _, base, real in clips.BASES[split]} for split in cases]
    assert bases[0].isdisjoint(bases[1])


@pytest.mark.parametrize(
    ("error", "rms", "stated", "verdict"),
    [
        (np.nan, np.nan, np.inf, "rejected"),
        (0.4, 0.2, 0.1, "right"),
        (0.4, 0.3, 0.05, "understated"),
        (3.0, 2.0, 1.5, "wrong but uncertain"),
        (3.0, 2.0, 0.5, "wrong and overconfident"),
        (3.0, 2.0, np.nan, "wrong and overconfident"),
    ],
)
def test_verdicts(error, rms, stated, verdict):
    assert judge.decide_verdict(error, rms, stated) == verdict


def test_breakpoint_is_the_last_level_before_the_first_that_fails():
    frames = pd.DataFrame({"rank": [0, 0, 1, 1, 2, 2], "error": [0.1, 0.1, 0.2, np.nan, 0.1, 0.1]})
    assert judge.find_breakpoint(frames) == 0
    assert judge.find_breakpoint(frames[frames["rank"] != 1]) == 1
    assert judge.find_breakpoint(frames[frames["rank"] == 1]) == -1


def test_rejections_are_counted_up_to_the_breakpoint_of_the_others():
    frames = pd.DataFrame(
        {
            "method": "geoaim",
            "kind": "noise",
            "level": [2.0, 2.0, 8.0, 20.0],
            "rank": [0, 0, 1, 2],
            "verdict": ["right", "rejected", "right", "rejected"],
        }
    )
    ranks = {"noise": 1}
    assert judge.measure_rejections(frames, ranks) == pytest.approx(1 / 3)


def test_seeds_of_earlier_sweeps_are_left_out():
    before, after = (list(clips.list_cases("test", ["plain"], skipped=n)) for n in (0, 1))
    assert {case.seed for case in before}.isdisjoint(case.seed for case in after)


def test_sweep_is_judged_written_and_read_again(tmp_path):
    rows = []
    for rank, level in enumerate((2.0, 6.0)):
        case = clips.SweepCase("plain", rank, level, "splines", "town", (270, 480), 4)
        clip = clips.make_clip(case, count=4)
        rows += sweep.run_geoaim(case, clip)
        methods = {"identity": lambda frames, _: (np.tile(np.eye(3), (len(frames), 1, 1)), [0.0])}
        rows += sweep.run_rivals(case, clip, methods)
    frames = pd.DataFrame(rows)
    ours = frames[frames.method == "geoaim"]
    assert set(ours.verdict) <= {"right", "understated"}
    assert ours.error.max() < 0.3 < frames[frames.method == "identity"].error.max()
    charts.write_cases(frames, tmp_path / "a.json")
    again = charts.read_cases([tmp_path / "a.json"])
    np.testing.assert_allclose(again.error.to_numpy(), frames.error.to_numpy(), atol=1e-3)
    text = charts.write_report(again, tmp_path, "a")
    assert "plain" in text
    assert (tmp_path / "a.png").stat().st_size > 1000


@pytest.mark.slow
def test_benchmark_sweeps_the_kinds_that_it_is_given(monkeypatch):
    monkeypatch.setattr(benchmark, "QUICK_KINDS", ["plain"])
    monkeypatch.setattr(clips, "SMALL", SMALL)
    monkeypatch.setattr(clips, "LARGE", SMALL)
    results = benchmark.measure_stability(True, no_progress)
    assert [row["kind"] for row in results.tables["rows"]] == ["plain"]
    assert [row["method"] for row in results.tables["methods"]] == ["geoaim", sweep.RIVALS[0]]
    assert list(results.charts) == ["strips"]
