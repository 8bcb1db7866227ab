"""The file that is shipped: the network for OpenCV, and its calibration."""

import json
import warnings
from pathlib import Path

import numpy as np
import torch
from numpy import ndarray as Array

from benchmarks.detection.network import Network


def export_network(network: Network, path: Path) -> None:
    """Write a network as ONNX, which needs the package `onnx`."""
    network.eval()
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")
        torch.onnx.export(
            network,
            (torch.zeros(1, 3, 64, 64),),
            str(path),
            dynamo=False,
            opset_version=13,
            input_names=["image"],
            output_names=["output"],
            dynamic_axes={"image": {2: "height", 3: "width"}, "output": {2: "h", 3: "w"}},
        )


def fit_calibration(logits: Array, right: Array, weights: Array) -> dict[str, float]:
    """Fit the slope and offset of log odds by weighted logistic regression (Platt)."""
    line = np.array([1.0, 0.0])
    columns = np.stack([logits, np.ones(len(logits))])
    for _ in range(60):
        p = 1 / (1 + np.exp(-line @ columns))
        hessian = (weights * p * (1 - p) * columns) @ columns.T
        line = line - np.linalg.solve(hessian, columns @ (weights * (p - right)))
    return {"slope": round(float(line[0]), 4), "offset": round(float(line[1]), 4)}


def write_calibration(calibration: dict[str, float], path: Path) -> None:
    """Write the calibration beside the network."""
    path.write_text(json.dumps({"calibration": calibration}, indent=1) + "\n", "utf-8")
