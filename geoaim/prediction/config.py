"""Hyperparameters of models and trainings, with the defaults of each agent group.

What is the same for all trainings, such as the limit of the gradient norm, is in `training.py`.
"""

from dataclasses import dataclass, replace

from geoaim.base.defaults import MAX_HISTORY_STEPS as MAX_HISTORY_STEPS
from geoaim.prediction.observation import ObservationView
from geoaim.rendering.lines import LIGHT_BAR_WIDTH_M

# length of a training segment: 4 s and 12 s, as in the paper; cyclists are not in it
SEGMENT_STEPS = {"vehicle": 40, "pedestrian": 30, "cyclist": 40}
# steps from one segment's start to the next
SEGMENT_STRIDES = {"vehicle": 20, "pedestrian": 5, "cyclist": 10}


@dataclass(frozen=True)
class Config:
    """Hyperparameters of an ITRA model.

    Attributes:
        kind: group of the agents that the model controls, "vehicle", "pedestrian" or "cyclist".
        motion: kinematic model: "bicycle", "unicycle", or "slide" for tracks of positions without
            measured headings.
        dt: time between steps, s.
        use_observations: whether the model gets rendered views; without them it knows the agent's
            own motion and size only.
        view_size: side of a view, pixels: an agent sees the square of view_size x resolution metres
            about it.
        resolution: metres per pixel of a view.
        surface_contrast: whether views have a channel of the colour distance to the ground under
            the agent.
        light_width: width of a light's bar on its stop line, metres.
        view_stride: encode a view every `view_stride` steps and reuse its features in between; 1 as
            in the paper.
        hidden_size: width of the GRU's hidden state.
        feature_size: width of an encoded view.
        latent_size: width of the latent z.
        latent_steps: steps for which a latent is kept in samples; 1 as in the paper. Longer ones
            make futures that differ by a decision rather than by a jitter.
        brakes: whether rules make vehicles stop for others and before red lights, and start again
            (`geoaim.prediction.controllers`).
        latent_scale: standard deviation of latents when futures are sampled; 1 as in training. With
            less, samples lie closer together.
        sigma: standard deviation of states in the likelihood, metres.
        heading_scale: an error of 1 rad counts as this many metres in the likelihood: half an
            agent's length.
        num_anchors: trajectory proposals; 0 as in the paper.
        anchor_points: points of a proposal, evenly spaced in time, the last one at its end.
        history: observed steps that proposals need; 0 without proposals.
        horizon: predicted steps that proposals cover; 0 without proposals.
    """

    kind: str
    motion: str
    dt: float
    use_observations: bool = True
    view_size: int = 64
    resolution: float = 0.8
    surface_contrast: bool = False
    light_width: float = LIGHT_BAR_WIDTH_M
    view_stride: int = 5
    hidden_size: int = 128
    feature_size: int = 96
    latent_size: int = 8
    latent_scale: float = 1.0
    latent_steps: int = 1
    brakes: bool = False
    sigma: float = 0.2
    heading_scale: float = 2.0
    num_anchors: int = 0
    anchor_points: int = 3
    history: int = 0
    horizon: int = 0

    @property
    def view(self) -> ObservationView:
        """The view of an agent."""
        return ObservationView(
            self.view_size, self.view_size, self.resolution, light_width=self.light_width
        )


DEFAULT_CONFIGS = {
    "vehicle": Config(
        kind="vehicle",
        motion="bicycle",
        dt=0.1,
        view_size=48,
        resolution=1.0,
        surface_contrast=True,  # lanes mostly continue on a surface of the same colour
        light_width=8.0,  # models learn nothing from bars of one pixel
    ),
    "pedestrian": Config(
        kind="pedestrian",
        motion="unicycle",
        dt=0.4,
        view_size=48,
        resolution=0.5,
        view_stride=3,
        heading_scale=0.25,
    ),
    # not tuned: the motion and rate of vehicles at the size of a bicycle
    "cyclist": Config(
        kind="cyclist",
        motion="bicycle",
        dt=0.2,
        view_size=48,
        resolution=0.75,
        view_stride=3,
        light_width=8.0,
        heading_scale=1.0,
    ),
}


@dataclass(frozen=True)
class TrainConfig:
    """Hyperparameters of a training run."""

    steps: int  # number of optimiser steps
    batch_size: int = 64  # segments of a step, of all processes together
    learning_rate: float = 2e-3  # the highest one, of one cycle (Smith 2018)
    # weight of the KL term after its warm-up. 1 is the evidence lower bound; a larger weight leaves
    # less information in latents, and models rely more on the observation
    kl_weight: float = 3.0
    # share of the steps in which that weight rises from zero, so that latents come to be used
    # (Bowman et al. 2016)
    kl_warmup: float = 0.3
    # least and most observed steps, drawn for each batch
    history: tuple[int, int] = (1, MAX_HISTORY_STEPS)
    # share of the steps over which ever fewer proposals of each agent are trained, all at first and
    # one in the end; 0: one from the start
    anchor_annealing: float = 0.8
    # whether half of the batches are mirrored; not for agents that keep to one side
    mirror: bool = False
    scale_jitter: float = 0.0  # largest share by which a batch is scaled up or down
    # largest share by which a batch's map is made brighter or darker, by channel
    colour_jitter: float = 0.0
    # most metres, and largest share, by which a batch's maps are misplaced and wrongly scaled
    map_shift: float = 0.0
    map_scale: float = 0.0
    seed: int = 0  # random seed
    checkpoint_interval: int = 250  # steps from one checkpoint to the next
    log_start: bool = False  # whether the log begins with minADE before the first step


def configure_training(group: str, *, steps: int, batch_size: int, seed: int = 0) -> TrainConfig:
    """Configure the training of a new model.

    Args:
        group: group of the agents that the model controls, a key of `DEFAULT_CONFIGS`.
        steps: number of optimiser steps.
        batch_size: segments of a step.
        seed: random seed.

    Returns:
        The hyperparameters.
    """
    mirror = group == "pedestrian"  # pedestrians keep to no side of the road
    return TrainConfig(steps, batch_size, mirror=mirror, seed=seed)


def configure_fine_tuning(group: str, *, steps: int, batch_size: int, seed: int = 0) -> TrainConfig:
    """Configure the fine-tuning of a trained model: a low learning rate, and no warm-up.

    Args:
        group: group of the agents that the model controls, a key of `DEFAULT_CONFIGS`.
        steps: number of optimiser steps.
        batch_size: segments of a step.
        seed: random seed.

    Returns:
        The hyperparameters.
    """
    return replace(
        configure_training(group, steps=steps, batch_size=batch_size, seed=seed),
        learning_rate=5e-4,
        kl_warmup=0.0,
        anchor_annealing=0.0,
        checkpoint_interval=50,
        log_start=True,
    )
