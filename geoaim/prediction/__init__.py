"""ITRA: what agents do next, learnt from image maps; trained, sampled, judged.

model = read_model(shipped("vehicle"))
futures = predict(model, scene, samples=6, steps=40, generator=generator)
"""

from geoaim.prediction.baselines import BASELINES, predict_plainly
from geoaim.prediction.checkpoints import read_model, shipped, write_model
from geoaim.prediction.evaluation import Asked, evaluate, evaluate_windows
from geoaim.prediction.itra import ITRA, Config
from geoaim.prediction.lessons import HELD_OUT, Lessons, make_lessons
from geoaim.prediction.metrics import interval, measure, summary
from geoaim.prediction.predict import predict
from geoaim.prediction.segments import Segments, cut_segments
from geoaim.prediction.training import Training, train
from geoaim.prediction.windows import Windows, read_windows

__all__ = [
    "BASELINES",
    "HELD_OUT",
    "ITRA",
    "Asked",
    "Config",
    "Lessons",
    "Segments",
    "Training",
    "Windows",
    "cut_segments",
    "evaluate",
    "evaluate_windows",
    "interval",
    "make_lessons",
    "measure",
    "predict",
    "predict_plainly",
    "read_model",
    "read_windows",
    "shipped",
    "summary",
    "train",
    "write_model",
]
