"""Model files and training checkpoints."""

import os
from dataclasses import asdict
from io import BytesIO
from pathlib import Path
from typing import Any
from zipfile import ZIP_STORED, ZipFile

import torch

from geoaim.base.checksums import (
    PLACEHOLDER,
    FileFormat,
    check_version,
    verify_checksum,
    write_checksum,
)
from geoaim.base.errors import ModelError
from geoaim.base.files import atomic_write
from geoaim.base.limits import refuse_damaged
from geoaim.prediction.config import Config
from geoaim.prediction.familiarity import KnownViews
from geoaim.prediction.itra import ITRA
from geoaim.prediction.plain import PlainNetwork

FORMAT = FileFormat("model", 2, 3, first_checked=3, error=ModelError)
MAX_NUMBERS = {"dt": 10, "resolution": 100, "view_size": 1024, "view_stride": 1000}
# of the configs of earlier versions; a model with "neighbours" has unknown weights, and what a
# network that "reacts" did, the rules do alone
DROPPED = ("neighbours", "reacts")
PRETRAINED = Path(__file__).parent / "models"


def write_model(model: ITRA, path: str | os.PathLike[str]) -> None:
    """Write a model's config, weights (16-bit floats), and what views it knows."""
    weights = {
        name: value.detach().cpu().half()
        for name, value in model.state_dict().items()
        if not name.startswith("own_place.")
    }
    state: dict[str, Any] = {"config": asdict(model.config), "weights": weights}
    if (place := model.own_place) is not None:
        tensors = {name: value.cpu() for name, value in place.state_dict().items()}
        state["own_place"] = {
            "history": place.history,
            "horizon": place.horizon,
            "weights": tensors,
        }
    if (known := model.known_views) is not None:
        tensors = {name: getattr(known, name).cpu().float() for name in ("mean", "whitening")}
        state["known_views"] = {**tensors, "limit": known.limit}
    write_state(state, path)


def read_model(path: str | os.PathLike[str]) -> ITRA:
    """Read a `model.pt`; the model is on the CPU, in evaluation mode.

    Raises:
        FileNotFoundError: there is no such file.
        ModelError: the file is not a model, is damaged, or a weight is not finite.
    """
    state = read_state(path)
    if "optimiser" in state:
        raise ModelError(f"{path} is a training checkpoint; give the model.pt beside it")
    with refuse_damaged(path, ModelError, "a model of this version"):
        with torch.device("meta"):  # the file's weights are the only memory that is needed
            model = ITRA(make_config(state["config"]))
        weights = _load(model, state["weights"])
        if "known_views" in state:
            model.known_views = KnownViews(**state["known_views"])
        if "own_place" in state:
            model.own_place, own = _read_place(model.config, state["own_place"])
            weights |= own
    infinite = [name for name, value in weights.items() if not value.isfinite().all()]
    if infinite:
        raise ModelError(
            f"{path}: weights of {', '.join(infinite[:3])} are not finite numbers; train it again"
        )
    return model.eval()


def make_config(stated: dict[str, Any]) -> Config:
    """The config of a file, whose numbers would otherwise fail in a simulation, far from it."""
    for name, limit in MAX_NUMBERS.items():
        value = stated.get(name, limit)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 0 < value <= limit:
            raise ValueError(f"its {name} is {value!r}; a number up to {limit:g} is needed")
    return Config(**{name: value for name, value in stated.items() if name not in DROPPED})


def _load(module: torch.nn.Module, stored: dict[str, torch.Tensor]) -> dict[str, torch.Tensor]:
    """Give a module the weights of a file, if they need no more memory than the file has."""
    for name, value in stored.items():
        if value.layout != torch.strided or value.device.type != "cpu":
            raise ValueError(f"its {name} is no tensor of numbers")
        if value.untyped_storage().nbytes() < value.nbytes:
            raise ValueError(f"its {name} has more numbers than the file")
    weights = {k: value.float() for k, value in stored.items() if not k.startswith("reaction.")}
    module.load_state_dict(weights, assign=True)
    return weights


def _read_place(
    config: Config, state: dict[str, Any]
) -> tuple[PlainNetwork, dict[str, torch.Tensor]]:
    """Make the network of a place from its part of a file; with its weights."""
    cells = state["weights"].get("cells")
    with torch.device("meta"):
        network = PlainNetwork(config, state["history"], state["horizon"], cells=cells)
    return network, _load(network, state["weights"])


def read_pretrained(kind: str) -> ITRA:
    """Read the model "vehicle" or "pedestrian" that comes with the package; see `read_model`.

    >>> read_pretrained("pedestrian").config.motion
    'unicycle'
    """
    return read_model(PRETRAINED / f"{kind}.pt")


def write_state(state: dict[str, Any], path: str | os.PathLike[str]) -> None:
    """Write numbers and tensors by their names; an interrupted write leaves the old file."""
    content = BytesIO()  # first in memory: on a full disk torch names neither it nor the file
    torch.save({"format": FORMAT.newest, **state}, content)
    content.write(PLACEHOLDER.encode())  # zip archives may be followed by other bytes
    with atomic_write(path) as temporary:
        temporary.write_bytes(content.getbuffer())
        write_checksum(temporary)


def read_state(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a state that `write_state` wrote, without running code from the file.

    Raises:
        FileNotFoundError: there is no such file.
        ModelError: the file is not such a state, is damaged, or has another version.
    """
    path = Path(path)
    if path.is_dir():
        raise IsADirectoryError(f"{path} is a folder; give the model.pt in it")
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file")
    has_checksum = verify_checksum(path, FORMAT)
    try:
        with ZipFile(path) as archive:  # packed, a small file could need any memory
            if any(record.compress_type != ZIP_STORED for record in archive.infolist()):
                raise ValueError("packed")
        state = torch.load(path, map_location="cpu", weights_only=True)
    except Exception:  # pickle, zip and torch raise errors of their own
        raise ModelError(f"{path} is not a model that geoaim wrote; give a model.pt") from None
    stated = state.get("format") if isinstance(state, dict) else None
    check_version(path, stated, FORMAT, has_checksum=has_checksum)
    return state
