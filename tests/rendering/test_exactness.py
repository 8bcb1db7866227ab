"""Pictures and gradients of 500 random scenes, beside exact areas by shapely."""

import math
from dataclasses import replace

import numpy as np
import pytest
import torch

from geoaim.rendering import OrientedBoxes, View, make_ground, render
from tests.rendering.shapely_renderer import draw
from tests.sizes import keep_quick

MATRIX = torch.tensor([[1.5, 0.4, 21.0], [0.4, -1.5, 19.0]], dtype=torch.float64)
BORDER = np.array([[0, 0, 1], [0, 0, 1]])  # pixels around the texture
SCENES = 500
HEADINGS = (math.pi, -math.pi, 0.0, math.pi / 2)  # beside any others


def make_scene(seed):
    """A view, a camera, a ramp in three colours and boxes, some of them extreme."""
    generator = np.random.default_rng(seed)
    view = View(*generator.integers(5, 13, 2).tolist(), float(generator.uniform(0.3, 2.0)))
    count = 500 if seed % 100 == 0 else int(generator.integers(1, 9))
    reach = view.resolution * max(view.height, view.width)  # half of the boxes lie outside
    camera = np.append(generator.uniform(-3, 3, 2), generator.choice([*HEADINGS, 1.3, -2.2]))
    poses = np.column_stack(
        [
            camera[:2] + generator.uniform(-0.7, 0.7, (count, 2)) * reach,
            generator.choice([*HEADINGS, *generator.uniform(-4, 4, 8)], count),
        ]
    )
    pixels = np.exp(generator.uniform(np.log(0.1), np.log(300), (count, 2)))
    if seed % 2:
        pixels = generator.uniform(0.5, 8, (count, 2))
    colours, triangle_colours = generator.random((2, count, 3))
    return view, camera, poses, pixels * view.resolution, colours, triangle_colours


def make_image():
    v, u = np.mgrid[:40, :40] / 40
    return np.stack([0.1 + 0.5 * u + 0.3 * v, 0.9 - 0.6 * u, 0.2 + 0.7 * v])


def draw_reference(view, camera, poses, sizes, colours, triangle_colours, image):
    boxes = list(zip(poses, sizes, colours, triangle_colours, strict=True))
    padded = np.pad(image, ((0, 0), (1, 1), (1, 1)), constant_values=0.5)
    return draw(view, camera, padded, MATRIX.numpy() + BORDER, boxes)


def render_arrays(ground, view, arrays):
    """The picture, and what it was made of."""
    tensors = [torch.tensor(array).requires_grad_() for array in arrays]
    camera, poses, sizes, colours, triangle_colours = tensors
    boxes = OrientedBoxes(poses[None], sizes, colours, heading_colours=triangle_colours)
    return render(view, camera[None], ground, [boxes])[0], tensors[1:]


@pytest.mark.parametrize("part", keep_quick(range(10), 0, 4))
def test_pictures_and_gradients_are_those_of_exact_areas(part):
    image = make_image()
    ground = replace(make_ground(torch.tensor(image), MATRIX), finest=math.inf)  # a ramp
    for seed in range(part, SCENES, 10):
        view, camera, *arrays = make_scene(seed)
        generator = np.random.default_rng(1000 + seed)
        expected = draw_reference(view, camera, *arrays, image)
        # the gradient along a random direction; the camera stays, since the ramp has a kink at
        # its edge
        weights = generator.random(expected.shape)
        steps = [generator.standard_normal(array.shape) for array in arrays]
        steps[1] *= arrays[1] / 10
        low, high = (
            draw_reference(
                view, camera, *(a + h * s for a, s in zip(arrays, steps, strict=True)), image
            )
            for h in (-1e-6, 1e-6)
        )
        slope = float((weights * (high - low)).sum() / 2e-6)
        picture, leaves = render_arrays(ground, view, [camera, *arrays])
        assert np.abs(picture.detach().numpy() - expected).max() < 1e-6, seed
        grads = torch.autograd.grad((picture * torch.tensor(weights)).sum(), leaves)
        products = [g.numpy() * s for g, s in zip(grads, steps, strict=True)]
        along, size = sum(map(np.sum, products)), sum(np.abs(p).sum() for p in products)
        assert abs(along - slope) < 1e-5 * max(1.0, size), seed
