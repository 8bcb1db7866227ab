import pytest

from geoaim.prediction.config import configure_fine_tuning, configure_training


@pytest.mark.parametrize("configure", [configure_training, configure_fine_tuning])
def test_only_pedestrians_are_mirrored_since_vehicles_keep_to_a_side(configure):
    given = {"steps": 7, "batch_size": 3, "seed": 5}
    vehicles, pedestrians = configure("vehicle", **given), configure("pedestrian", **given)
    assert pedestrians.mirror
    assert not vehicles.mirror
    assert (vehicles.steps, vehicles.batch_size, vehicles.seed) == (7, 3, 5)


def test_fine_tuning_starts_slowly_and_without_a_warm_up():
    new, tuned = (
        configure("vehicle", steps=7, batch_size=3)
        for configure in (configure_training, configure_fine_tuning)
    )
    assert tuned.learning_rate < new.learning_rate
    assert tuned.kl_warmup == tuned.anchor_annealing == 0.0
    assert tuned.log_start
    assert not new.log_start
