"""ITRA: trajectory prediction from image maps; datasets, training, sampling, evaluation.

model = read_pretrained("vehicle")
futures = predict(model, scene, samples=6, horizon=40, generator=generator)
"""

from geoaim.prediction.baselines import BASELINES, Predictor
from geoaim.prediction.checkpoints import read_model, read_pretrained, write_model
from geoaim.prediction.config import (
    DEFAULT_CONFIGS,
    Config,
    TrainConfig,
    configure_fine_tuning,
    configure_training,
)
from geoaim.prediction.cutting import cut_segments
from geoaim.prediction.dataset import Dataset, make_dataset
from geoaim.prediction.evaluation import EvalConfig, evaluate
from geoaim.prediction.items import SegmentItems
from geoaim.prediction.itra import ITRA
from geoaim.prediction.metrics import Metric, bootstrap_interval, compute_metrics, summarise
from geoaim.prediction.plain import PlainNetwork, train_plain
from geoaim.prediction.plans import Goal
from geoaim.prediction.policies import ITRAPolicy, make_traffic
from geoaim.prediction.predict import predict
from geoaim.prediction.rollouts import Rollout
from geoaim.prediction.segments import Segments
from geoaim.prediction.training import init_model, learn_place, train
from geoaim.prediction.trial import choose_noise, describe_trial, judge_before

__all__ = [
    "BASELINES",
    "DEFAULT_CONFIGS",
    "ITRA",
    "Config",
    "Dataset",
    "EvalConfig",
    "Goal",
    "ITRAPolicy",
    "Metric",
    "PlainNetwork",
    "Predictor",
    "Rollout",
    "SegmentItems",
    "Segments",
    "TrainConfig",
    "bootstrap_interval",
    "choose_noise",
    "compute_metrics",
    "configure_fine_tuning",
    "configure_training",
    "cut_segments",
    "describe_trial",
    "evaluate",
    "init_model",
    "judge_before",
    "learn_place",
    "make_dataset",
    "make_traffic",
    "predict",
    "read_model",
    "read_pretrained",
    "summarise",
    "train",
    "train_plain",
    "write_model",
]
