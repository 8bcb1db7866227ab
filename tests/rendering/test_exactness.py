"""Pictures of random scenes beside exact areas by shapely, and gradients beside differences."""

import math
from dataclasses import replace

import numpy as np
import torch

from geoaim.rendering import OrientedBoxes, View, make_ground, render
from tests.rendering.shapely_renderer import draw

MATRIX = torch.tensor([[1.5, 0.4, 21.0], [0.4, -1.5, 19.0]], dtype=torch.float64)
BORDER = np.array([[0, 0, 1], [0, 0, 1]])  # pixels around the texture
SCENES = 60
HEADINGS = (math.pi, -math.pi, 0.0, math.pi / 2)  # beside any others


def make_scene(seed):
    """A view, a camera, a ramp in three colours and boxes, some of them extreme."""
    generator = np.random.default_rng(seed)
    view = View(*generator.integers(5, 13, 2).tolist(), float(generator.uniform(0.3, 2.0)))
    count = int(generator.integers(1, 9))
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
    """The picture of boxes in layers of their own, and what it was made of."""
    tensors = [torch.tensor(array).requires_grad_() for array in arrays]
    camera, poses, sizes, colours, triangle_colours = tensors
    layers = [
        OrientedBoxes(poses[None, [k]], sizes[[k]], colours[[k]], heading_colours=tips[None])
        for k, tips in enumerate(triangle_colours)
    ]
    return render(view, camera[None], ground, layers)[0], tensors


def test_pictures_are_close_to_those_of_exact_areas():
    image = make_image()
    ground = replace(make_ground(torch.tensor(image), MATRIX), finest=math.inf)  # a ramp
    errors = []
    for seed in range(SCENES):
        view, camera, *arrays = make_scene(seed)
        expected = draw_reference(view, camera, *arrays, image)
        picture, _ = render_arrays(ground, view, [camera, *arrays])
        errors.append(255 * np.abs(picture.detach().numpy() - expected).mean())
    assert np.mean(errors) < 1
    assert np.max(errors) < 6  # half of the boxes are of few pixels


def test_gradients_are_those_of_what_is_drawn():
    ground = replace(make_ground(torch.tensor(make_image()), MATRIX), finest=math.inf)
    for seed in range(SCENES):
        view, *arrays = make_scene(seed)
        generator = np.random.default_rng(1000 + seed)
        arrays[1] += generator.uniform(-0.01, 0.01, arrays[1].shape)  # off the kinks
        picture, leaves = render_arrays(ground, view, arrays)
        weights = torch.tensor(generator.random(picture.shape))
        steps = [generator.standard_normal(array.shape) for array in arrays]
        steps[0] *= 0  # the ramp has a kink at its edge
        steps[2] *= arrays[2] / 10
        low, high = (
            render_arrays(ground, view, [a + h * s for a, s in zip(arrays, steps, strict=True)])[0]
            for h in (-1e-7, 1e-7)
        )
        slope = float((weights * (high - low)).sum().detach()) / 2e-7
        grads = torch.autograd.grad((picture * weights).sum(), leaves)
        products = [g.numpy() * s for g, s in zip(grads, steps, strict=True)]
        along, size = sum(map(np.sum, products)), sum(np.abs(p).sum() for p in products)
        assert abs(along - slope) < 1e-5 * max(1.0, size), seed
