"""The paper's tables and public benchmarks, by their names in `python -m benchmarks.prediction`."""

from benchmarks.prediction import (
    aim_or_hdmap,
    known_views,
    latent_scales,
    observed_states,
    pedestrians,
    pretrained,
    reaction,
    robust,
    sind,
    songdo,
    standing,
    stanford,
    stanford_baselines,
    vehicles,
    zero_shot,
)

EXPERIMENTS = {
    "pretrained": pretrained.run,
    "aim_or_hdmap": aim_or_hdmap.run,
    "pedestrians": pedestrians.run,
    "vehicles": vehicles.run,
    "reaction": reaction.run,
    "standing": standing.run,
    "robust": robust.run,
    "known_views": known_views.run,
    "latent_scales": latent_scales.run,
    "stanford": stanford.run,
    "stanford_baselines": stanford_baselines.run,
    "songdo": songdo.run,
    "sind": sind.run,
    "zero_shot": zero_shot.run,
    "observed_states": observed_states.run,
}
