"""Models as files: weights with what they need to be used again."""

import os
from dataclasses import asdict
from pathlib import Path
from typing import Any

import torch

from geoaim.errors import ModelError
from geoaim.files import atomic_write
from geoaim.prediction.itra import ITRA, Config

FORMAT = 1
SHIPPED = Path(__file__).parent / "models"


def write_model(model: ITRA, path: str | os.PathLike[str]) -> None:
    """Write a model's config and weights, as 16-bit floats."""
    weights = {name: value.detach().cpu().half() for name, value in model.state_dict().items()}
    write_state({"config": asdict(model.config), "weights": weights}, path)


def read_model(path: str | os.PathLike[str]) -> ITRA:
    """Read a model, ready to sample from.

    Raises:
        ModelError: the file is none.
        OSError: there is no such file.
    """
    state = read_state(path)
    if "optimiser" in state:
        raise ModelError(f"{path} is a training that goes on; name the model.pt beside it")
    try:
        model = ITRA(Config(**state["config"]))
        model.load_state_dict({name: value.float() for name, value in state["weights"].items()})
    except (KeyError, TypeError, ValueError, AttributeError, RuntimeError) as error:
        raise ModelError(f"{path} is no model of this version: {error}") from None
    return model.eval()


def kept_model(path: Path, config: Config) -> ITRA:
    """A model that was trained before, if it is what would be trained now.

    Raises:
        ModelError: it is made otherwise.
    """
    model = read_model(path)
    if model.config != config:
        raise ModelError(f"{path} is of another config; delete its folder, or name another")
    return model


def shipped(kind: str) -> Path:
    """The file of the model of a kind that comes with the package; made places taught it."""
    return SHIPPED / f"{kind}.pt"


def write_state(state: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write numbers and tensors; an interrupted write leaves the old file."""
    with atomic_write(path) as temporary:
        torch.save({"format": FORMAT, **state}, temporary)


def read_state(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read what `write_state` wrote; nothing in the file is run.

    Raises:
        ModelError: the file is of something else.
        OSError: there is no such file.
    """
    path = Path(path)
    try:
        state = torch.load(path, map_location="cpu", weights_only=True)
    except FileNotFoundError:
        raise FileNotFoundError(f"{path}: no such file") from None
    except IsADirectoryError:
        raise IsADirectoryError(f"{path} is a folder; name the model.pt in it") from None
    except OSError:
        raise
    except Exception:  # pickle, zip and torch each have their own
        raise ModelError(f"{path} is no model that geoaim train wrote; name a model.pt") from None
    if not isinstance(state, dict) or state.get("format") != FORMAT:
        raise ModelError(f"{path} is no model of the form {FORMAT}; train it anew")
    return state
