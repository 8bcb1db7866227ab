"""Choice of a prediction model, and of the time it predicts."""

from pathlib import Path
from typing import TYPE_CHECKING

from geoaim.cli.options import AgentKind

if TYPE_CHECKING:
    from geoaim.prediction.itra import ITRA

DEFAULT_DURATIONS_S = {"vehicle": 4.0, "pedestrian": 8.0}  # that are predicted


def load_model(weights: Path | None, kind: AgentKind | None = None) -> "ITRA":
    """Load the model of a file, or the pretrained one; it must predict the given agents."""
    from geoaim.prediction.checkpoints import read_model, read_pretrained

    if weights is None:
        return read_pretrained(get_group(kind or "vehicles"))
    model = read_model(weights)
    if kind is not None and model.config.kind != get_group(kind):
        kinds = f"{model.config.kind}s"
        raise ValueError(f"{weights} is a model of {kinds}; give --kind {kinds}")
    return model


def get_group(kind: AgentKind) -> str:
    """Get the agent group, as models name it: "vehicle" or "pedestrian"."""
    return kind.removesuffix("s")


def get_horizon(model: "ITRA", duration: float | None = None) -> int:
    """Get the number of predicted steps: of a duration in s, or the default of the model."""
    config = model.config
    if duration is None and config.horizon:
        return config.horizon
    duration = DEFAULT_DURATIONS_S[config.kind] if duration is None else duration
    return max(1, round(duration / config.dt))
