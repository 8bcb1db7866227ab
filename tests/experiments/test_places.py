from dataclasses import replace

import cv2
import numpy as np
import pytest
import torch

from geoaim.experiments import EXPERIMENTS, cases, models, people, places, vehicles
from geoaim.experiments.learning import PEOPLE, TRAININGS, VEHICLES, judge, lessons_of
from geoaim.experiments.models import RECIPES
from geoaim.experiments.places import (
    ANNOTATED,
    COARSE,
    MAPS,
    TEST,
    TRAIN,
    make_places,
    read_map,
)
from geoaim.hdmap.rasterize import GROUND, ROAD, SURFACES
from geoaim.prediction.baselines import BASELINES
from geoaim.prediction.itra import ITRA
from geoaim.prediction.lessons import HELD_OUT
from geoaim.prediction.metrics import Measure
from geoaim.progress import no_progress

SMALL = replace(VEHICLES, size=16, resolution=3.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory):
    """A made place as experiments have them, of a minute instead of ten."""
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(places, "MINUTES", 1.0)
        patch.setattr(places, "RESOLUTION", 0.2)
        found = make_places(tmp_path_factory.mktemp("places"), [(5, "t")])
        read_map(found[0], "aim")
        assert make_places(found[0].parent, [(5, "t")]) == found  # it is there already
    return found[0]


def test_places_to_learn_from_are_not_those_to_be_judged_on():
    for who, learnt in TRAIN.items():
        assert not {seed for seed, _ in learnt} & {seed for seed, _ in TEST[who]}
        assert {kind for _, kind in TEST[who]} <= {kind for _, kind in learnt}
        assert 1 not in {seed for seed, _ in learnt}  # the bundled sample's


@pytest.mark.parametrize("name", MAPS)
def test_every_map_lies_where_the_place_does(folder, name):
    aim, found = read_map(folder, "aim"), read_map(folder, name)
    assert found.world == aim.world
    middle = aim.corners.mean(axis=0)
    assert (found.corners.min(axis=0) < middle).all()
    assert (middle < found.corners.max(axis=0)).all()
    if name == "degraded":
        coarse = round(COARSE / aim.resolution)
        apart = found.image.astype(float) - cv2.GaussianBlur(aim.image, (0, 0), coarse)
        assert 30 < apart.std() < 60  # noise of 51, cut off at both ends
        rows, columns = (side // coarse for side in apart.shape[:2])
        whole = apart[: rows * coarse, : columns * coarse]
        squares = whole.reshape(rows, coarse, columns, coarse, 3)
        assert squares.mean(axis=(1, 3)).std() > 30  # it does not average out over a metre
    if name == "none":
        assert found.image.std() == 0
    with pytest.raises(ValueError, match="no map 'best'"):
        read_map(folder, "best")


def test_hd_maps_say_more_and_more(folder):
    roads, lanes, whole = (read_map(folder, name).image for name in ANNOTATED)
    assert roads.shape == lanes.shape
    assert (roads.max(axis=(0, 1)) == ROAD).all()
    assert (roads.min(axis=(0, 1)) == GROUND).all()
    assert lanes.max() > 200  # lines
    assert (lanes[(roads == GROUND).all(axis=2)] != ROAD).any(axis=1).mean() > 0.99  # same roads
    for kind in ("walkway", "crosswalk", "parking"):
        shown = [(image == SURFACES[kind]).all(axis=2).mean() for image in (lanes, whole)]
        assert 10 * shown[0] < shown[1], kind


def test_models_learn_from_places_and_are_judged_on_them(folder):
    lessons = lessons_of([folder], SMALL, "aim", held_out=0.2)
    assert len(lessons.train) > 50
    assert lessons.train.states.shape[1] == lessons.valid.states.shape[1] == 40
    low, high = lessons.train.states[:, :, 0, :2].flatten(0, 1).aminmax(dim=0)
    shape = torch.tensor(lessons.ground.image.shape[:0:-1])
    matrix = lessons.ground.image_from_world
    pixels = torch.stack([low, high]) @ matrix[:, :2].t() + matrix[:, 2]
    assert (pixels > 0).all() and (pixels < shape).all()  # noqa: PT018
    found = judge("constant velocity", [folder], SMALL, "none", end=0.2)
    assert 0 < found["minADE"].mean < 10
    assert found["minADE"].mean == pytest.approx(found["joint minADE"].mean)


def test_every_experiment_says_what_it_is():
    assert all(run.__doc__ for run in EXPERIMENTS.values())
    assert {recipe.config.kind for recipe in RECIPES.values()} == set(TRAININGS)
    assert RECIPES["pedestrian_aim"].config == PEOPLE


def test_each_training_of_a_model_has_its_own_folder_and_seed(monkeypatch, tmp_path):
    asked = []

    def kept(where, config, training, lessons, report):
        asked.append((where.name, training.seed, config))
        return ITRA(SMALL)

    monkeypatch.setattr(models, "kept_or_trained", kept)
    for seed in (0, 1):
        models.trained("pedestrian_aim", tmp_path, seed=seed)
    assert asked == [("pedestrian_aim", 0, PEOPLE), ("pedestrian_aim_1", 1, PEOPLE)]


def test_cases_are_judged_where_they_say(monkeypatch, tmp_path):
    monkeypatch.setattr(
        cases, "make_places", lambda folder, places: [folder / kind for _, kind in places]
    )
    on_foot, driving = (
        {
            name: sorted(place.name for place in cases.places_of(case, table.config.kind, tmp_path))
            for name, case in table.cases.items()
        }
        for table in (people.TABLE, vehicles.TABLE)
    )
    assert set(on_foot["in parks, AIM"]) == {"park"}
    assert on_foot["AIM"] == sorted(on_foot["in parks, AIM"] + on_foot["along roads, AIM"])
    assert len(on_foot["AIM, last 5 %"]) == len(TRAIN["pedestrian"])
    assert set(driving["with private roads, AIM"]) == {"campus"}
    parts = driving["with private roads, AIM"] + driving["along public roads, AIM"]
    assert driving["AIM"] == sorted(parts)
    assert set(driving["at lights, AIM"]) == {"junction"}
    for table in (people.TABLE, vehicles.TABLE):
        assert {*table.shown, *(name for pair in table.pairs for name in pair)} <= set(table.cases)
        for case in table.cases.values():
            assert case.model in {*RECIPES, *BASELINES}
            assert case.map in MAPS


def test_trainings_of_one_model_are_judged_as_one(monkeypatch, tmp_path):
    """Two trainings that are wrong by 1 m and 3 m are wrong by 2 m."""

    def judge_at(model, at, config, name, *, end, lights):
        asked.append((model, at.name, name, end, lights))
        return [{"minADE": Measure(np.full(4, float(model)), np.ones(4))}]

    asked, written, drawn = [], {}, {}

    def write_results(name, tables, about):
        written.update(tables=tables, about=about)
        return [tmp_path / "people.json"]

    every = vehicles.TABLE.cases
    some = {name: every[name] for name in ("AIM", "at lights, AIM", "AIM, last 5 %")}
    unlit = {"no lights": every["at lights, AIM, lights not shown"]}
    table = replace(vehicles.TABLE, cases=some | unlit, pairs=(("AIM", "AIM"),), shown=("AIM",))
    fakes = {
        "write_futures_on_maps": lambda models, *_: drawn.update(models),
        "make_places": lambda folder, places, **_: [
            tmp_path / kind for kind in {k for _, k in places}
        ],
        "all_trained": lambda name, folder, report: ["1", "3"],
        "judge_at": judge_at,
        "write_results": write_results,
    }
    for name, fake in fakes.items():
        monkeypatch.setattr(cases, name, fake)
    cases.run_table("vehicles", table, tmp_path, no_progress)
    assert written["tables"]["AIM"]["minADE"].mean == 2
    assert len(asked) == len(set(asked))  # nothing is judged twice
    assert ("1", "junction", "aim", 1.0, True) in asked
    assert ("3", "junction", "aim", 1.0, False) in asked
    assert ("3", "street", "aim", HELD_OUT, True) in asked  # learnt from, not among the new ones
    assert drawn == {"vehicle_aim": "1"}
    each = written["about"]["each training, where there are more than one"]["AIM"]
    assert [one["minADE"] for one in each] == [1, 3]
