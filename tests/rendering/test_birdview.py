import math
from dataclasses import replace

import jaxtyping
import numpy as np
import pytest
import torch
from torch.nn.functional import avg_pool2d, interpolate

from benchmarks.rendering.peers import supersample
from geoaim.base.errors import GeoaimWarning
from geoaim.rendering import (
    OrientedBoxes,
    View,
    make_ground,
    make_path_boxes,
    prefilter_ground,
    render,
    render_coverage,
    render_layers,
)
from geoaim.rendering.prefiltering import _compute_weights

NORTH_UP = torch.tensor([[2.0, 0.0, 32.0], [0.0, -2.0, 32.0]], dtype=torch.float64)


@pytest.fixture
def without_shape_checks(monkeypatch):
    """Disable the shape checks of jaxtyping, as in use."""
    monkeypatch.setattr(jaxtyping.config, "jaxtyping_disable", True)


def _ground(colour=None):
    """64 x 64 pixels of half a metre around the origin: smooth, or of one colour."""
    v, u = torch.meshgrid(torch.arange(64.0), torch.arange(64.0), indexing="ij")
    waves = [0.5 + 0.3 * torch.sin(u / a) * torch.cos(v / b) for a, b in ((5, 7), (9, 4), (6, 6))]
    image = torch.stack(waves) if colour is None else torch.full((3, 64, 64), colour)
    return make_ground(image.double(), NORTH_UP)


def _scene(seed=0, views=2, count=4):
    """Cameras near the middle, and boxes that do not touch each other."""
    generator = torch.Generator().manual_seed(seed)
    random = torch.rand(views, 8 + 4 * count, generator=generator, dtype=torch.float64)
    cameras = torch.cat([random[:, :2] * 4 - 2, random[:, 2:3] * 6], 1)
    spots = torch.tensor([[-5.0, -5], [5, -5], [-5, 5], [5, 5]]).double()[:count]
    poses = torch.cat(
        [spots + random[:, 8 : 8 + count, None], random[:, 8 : 8 + count, None] * 6], 2
    )
    sizes = torch.tensor([[4.5, 1.9], [0.6, 0.5], [8.0, 2.5], [1.8, 0.7]]).double()[:count]
    colours = torch.rand(count, 3, generator=generator, dtype=torch.float64)
    return cameras, OrientedBoxes(poses, sizes, colours, heading_colours=1 - colours)


@pytest.mark.parametrize("resolution", [0.25, 0.5, 1.0])
def test_picture_agrees_with_the_supersampled_reference(resolution):
    cameras, boxes = _scene()
    view = View(48, 40, resolution)
    plain = _ground(0.5)  # as grey as what is outside of it
    result = render(view, cameras, plain, [boxes])
    apart = (result - supersample(view, cameras, plain, boxes)).abs() * 255
    assert apart.mean() < 0.2
    assert apart.max() < 30  # at the tips of triangles
    plain_boxes = replace(boxes, heading_colours=None)
    result = render(view, cameras, plain, [plain_boxes])
    apart = (result - supersample(view, cameras, plain, plain_boxes)).abs() * 255
    assert apart.mean() < 0.1
    assert apart.max() < 9  # at corners


def test_forward_is_up_and_left_is_left():
    camera = torch.tensor([[3.0, -2.0, np.pi / 2]])
    spots = torch.tensor([[[3.0, 4.0, 0.0], [-1.0, -2.0, 0.0]]])  # 6 m ahead, 4 m to the left
    boxes = OrientedBoxes(spots, torch.tensor([1.0, 1.0]).expand(2, 2), torch.eye(3)[:2])
    picture = render(View(20, 20, 1.0), camera, _single(0.0), [boxes])[0]
    assert picture[0, 3:5, 9:11].sum() == pytest.approx(1, abs=1e-5)
    assert picture[1, 9:11, 5:7].sum() == pytest.approx(1, abs=1e-5)


def _single(colour):
    ground = _ground(colour)
    return make_ground(ground.image[:, 1:-1, 1:-1].float(), NORTH_UP.float())


def test_pixel_of_the_ground_lies_where_its_transform_maps_it():
    image = torch.zeros(1, 64, 64)
    image[0, 20, 45] = 1.0  # x 6.75, y 5.75
    ground = make_ground(image, NORTH_UP.float())
    view = View(32, 32, 0.5)
    camera = torch.tensor([[4.5, 4.0, np.pi / 2]])
    row, column = np.unravel_index(int(render(view, camera, ground)[0, 0].argmax()), (32, 32))
    ahead, right = (16 - row - 0.5) * 0.5, (column + 0.5 - 16) * 0.5
    assert (4.5 + right, 4.0 + ahead) == (6.75, 5.75)


def test_boxes_of_a_layer_are_mixed_and_later_layers_are_painted_over_them():
    pose = torch.zeros(1, 2, 3)
    two = OrientedBoxes(pose, torch.full((2, 2), 4.0), torch.eye(3)[:2])
    top = OrientedBoxes(pose[:, :1], torch.full((1, 2), 2.0), torch.eye(3)[2:])
    picture = render(View(8, 8, 1.0), torch.zeros(1, 3), _single(0.0), [two, top])[0]
    assert picture[:, 4, 4].tolist() == [0, 0, 1]
    assert picture[:, 2, 2].tolist() == [0.5, 0.5, 0]


def test_absent_boxes_are_not_drawn_and_may_be_nan():
    _, boxes = _scene(views=1)
    poses = boxes.poses.clone()
    poses[0, 1] = torch.nan
    some = replace(boxes, poses=poses, present=torch.tensor([[True, False, True, False]]))
    rest = [0, 2]
    only = OrientedBoxes(
        poses[:, rest],
        boxes.sizes[rest],
        boxes.colours[rest],
        heading_colours=boxes.heading_colours[rest],
    )
    view, camera = View(32, 32, 0.7), torch.zeros(1, 3).double()
    result = render(view, camera, _ground(), [some])
    torch.testing.assert_close(result, render(view, camera, _ground(), [only]))


def test_gradients_agree_with_finite_differences():
    cameras, boxes = _scene(views=2, count=3)
    weight = torch.rand(2, 3, 12, 14, generator=torch.Generator().manual_seed(3)).double()
    view = View(12, 14, 1.3)
    ground = prefilter_ground(_ground(), view.resolution)

    def loss(cameras, poses, sizes, colours):
        layer = OrientedBoxes(poses, sizes, colours, heading_colours=boxes.heading_colours)
        return (weight * render(view, cameras, ground, [layer])).sum()

    given = [x.clone().requires_grad_() for x in (cameras, boxes.poses, boxes.sizes, boxes.colours)]
    assert torch.autograd.gradcheck(loss, given, eps=1e-6, atol=1e-6, rtol=1e-6)


def test_gradient_by_the_texture_is_zero_outside_the_view():
    image = _ground().image[:, 1:-1, 1:-1].clone().requires_grad_()
    ground = prefilter_ground(make_ground(image, NORTH_UP), 1.5)
    render(View(8, 8, 1.5), torch.zeros(1, 3).double(), ground).sum().backward()
    assert image.grad[:, 24:40, 24:40].min() > 0
    assert not image.grad[:, :8].any()


def test_overlapping_boxes_have_right_gradients():
    poses = torch.tensor([[[0.1, 0.2, 0.3], [0.9, 0.5, 1.0], [0.4, -0.6, 2.0]]]).double()
    sizes = torch.tensor([[4.0, 2.0]]).double().expand(3, 2)
    colours = torch.eye(3).double()
    weight = torch.rand(1, 3, 10, 10, generator=torch.Generator().manual_seed(0)).double()

    def loss(poses):
        picture = render(
            View(10, 10, 0.7),
            torch.zeros(1, 3).double(),
            _ground(),
            [OrientedBoxes(poses, sizes, colours)],
        )
        return (weight * picture).sum()

    assert torch.autograd.gradcheck(loss, poses.requires_grad_(), eps=1e-6, atol=1e-6, rtol=1e-6)


def test_pixels_beyond_the_ground_are_grey_and_not_covered():
    far = torch.tensor([[500.0, 0.0, 0.0]])
    view = View(8, 8, 1.0)
    assert (render(view, far, _single(0.0)) == 0.5).all()
    assert (render_coverage(view, far, _single(0.0)) == 0).all()
    assert (render_coverage(view, torch.zeros(1, 3), _single(0.0)) == 1).all()


@pytest.mark.parametrize("resolution", [0.7, 1.5, 4.0])
def test_prefiltered_ground_does_not_alias(resolution):
    """A fine checkerboard stays grey wherever the camera is."""
    board = ((torch.arange(512)[:, None] + torch.arange(512)) % 2).float().expand(1, 512, 512)
    ground = make_ground(board, torch.tensor([[4.0, 0, 256], [0, -4.0, 256]]))  # 0.25 m
    fitted = prefilter_ground(ground, resolution)
    cameras = torch.rand(8, 3, generator=torch.Generator().manual_seed(1))
    pictures = render(View(8, 8, resolution), cameras, fitted)
    assert (pictures - 0.5).abs().max() < 0.25 / resolution
    with pytest.warns(GeoaimWarning, match="call prefilter_ground"):
        aliased = render(View(8, 8, resolution), cameras, ground)
    assert (aliased - 0.5).abs().max() > 0.3


@pytest.mark.parametrize("side", [1.0, 2.5, 4.0])
def test_prefilter_is_even_about_its_middle(side):
    weights = _compute_weights(side)
    np.testing.assert_allclose(weights, weights[::-1], atol=1e-12)
    assert len(weights) % 2 == 1


def test_prefiltered_ground_stays_in_place():
    ground, camera = _ground(), torch.tensor([[1.0, 2.0, 0.5]]).double()
    view = View(10, 10, 2.0)
    fine = avg_pool2d(render(View(160, 160, 0.125), camera, ground), 16)
    result = render(view, camera, prefilter_ground(ground, 2.0))
    assert (result - fine).abs().max() < 0.06


def test_absent_boxes_have_no_gradient_even_if_nan():
    cameras, boxes = _scene(views=1)
    poses, sizes, colours = boxes.poses.clone(), boxes.sizes.clone(), boxes.colours.clone()
    poses[0, 1], sizes[3], colours[1] = torch.nan, torch.nan, torch.nan
    poses.requires_grad_()
    cameras.requires_grad_()
    present = torch.tensor([[True, False, True, False]])
    some = OrientedBoxes(poses, sizes, colours, present, 1 - colours)
    picture = render(View(16, 16, 1.0), cameras, _ground(), [some])
    picture.square().sum().backward()
    assert torch.isfinite(picture).all()
    assert torch.isfinite(cameras.grad).all()
    assert torch.isfinite(poses.grad).all()
    assert not poses.grad[0, [1, 3]].any()
    assert poses.grad[0, 0].all()


@pytest.mark.parametrize("size", [(4.0, 2.0), (4.5, 2.0), (3.0, 1.0)])
def test_edges_on_the_borders_of_pixels_have_gradients(size):
    """The ego in its own picture: whole numbers of pixels, and every edge on a border."""
    pose = torch.tensor([[123.4, 56.7, 0.9]], dtype=torch.float64)
    box = torch.tensor([size], dtype=torch.float64).requires_grad_()
    place = pose[:, None].clone().requires_grad_()
    dark = make_ground(torch.zeros(1, 1, 1).double(), NORTH_UP, outside=torch.zeros(1).double())
    boxes = OrientedBoxes(place, box, torch.ones(1, 1).double())
    area = render(View(64, 64, 0.5), pose, dark, [boxes]).sum() * 0.25
    of_place, of_size = torch.autograd.grad(area, (place, box))
    assert float(area.detach()) == pytest.approx(size[0] * size[1])
    assert of_place.abs().max() < 1e-6
    torch.testing.assert_close(of_size[0].flip(0), box[0].detach(), rtol=0.06, atol=0)


def test_path_has_no_gaps_where_its_lines_meet():
    points = torch.tensor([[-9.0, 0.3], [-2.4, 0.3], [3.7, 0.3], [3.7, 6.9]])[None, None]
    paths = make_path_boxes(points, torch.ones(1, 1), width=1.0)
    dark = make_ground(torch.zeros(1, 1, 1), NORTH_UP.float(), outside=torch.zeros(1))
    camera = torch.tensor([[0.2, 0.8, np.pi / 2]])  # so that the lines fill whole pixels
    picture = render(View(16, 16, 1.0), camera, dark, [paths])[0, 0]
    torch.testing.assert_close(picture[8, :12], torch.ones(12), atol=1e-4, rtol=0)
    torch.testing.assert_close(picture[3:9, 11], torch.ones(6), atol=1e-4, rtol=0)


@pytest.mark.parametrize("ratio", [2.0, 8.0, 60.0])
def test_edge_of_a_prefiltered_ground_is_one_pixel_soft(ratio):
    white = make_ground(
        torch.ones(1, 50, 50).double(),
        torch.tensor([[1.0, 0, 0], [0, -1.0, 50]]).double(),
        outside=torch.zeros(1).double(),
    )
    view, camera = View(24, 24, ratio), torch.tensor([[1.0, 2.0, 0.4]]).double()
    fine = View(24 * 24, 24 * 24, ratio / 24)
    unfiltered = replace(white, finest=math.inf)  # without its warning
    expected = avg_pool2d(render(fine, camera, unfiltered), 24)
    fitted = prefilter_ground(white, ratio)
    assert (render(view, camera, fitted) - expected).abs().max() < 0.16
    assert float(render(view, camera, fitted).sum()) == pytest.approx(
        float(expected.sum()), rel=0.03
    )
    assert (render_coverage(view, camera, fitted) - expected).abs().max() < 0.16


def test_no_map_is_a_plain_colour():
    plain = make_ground(torch.zeros(3, 1, 1), NORTH_UP, outside=torch.tensor([0.1, 0.2, 0.3]))
    picture = render(View(5, 7, 2.0), torch.tensor([[90.0, 0, 1]]), plain)
    torch.testing.assert_close(
        picture, torch.tensor([0.1, 0.2, 0.3])[None, :, None, None].expand(1, 3, 5, 7)
    )


@pytest.mark.parametrize("ratio", [1.0, 2.0, 4.0, 8.0, 16.0])
def test_prefiltered_ground_is_close_to_the_mean_over_a_rotated_pixel(ratio):
    """A scene of hard edges, at most as fine as the camera that took it."""
    generator = torch.Generator().manual_seed(2)
    scene = torch.rand(1, 1, 32, 32, generator=generator, dtype=torch.float64).round()
    image = avg_pool2d(interpolate(scene, scale_factor=24), 3)[0]  # 256 px, edges everywhere
    ground = make_ground(image, torch.tensor([[1.0, 0, 128], [0, -1.0, 128]]).double())
    view, camera = View(10, 10, ratio), torch.tensor([[0.3, -0.4, 0.6]]).double()
    fine = View(160, 160, ratio / 16)
    expected = avg_pool2d(render(fine, camera, ground), 16)
    apart = (render(view, camera, prefilter_ground(ground, ratio)) - expected).abs() * 255
    unfiltered = replace(ground, finest=math.inf)  # without its warning
    plain = (render(view, camera, unfiltered) - expected).abs() * 255
    assert apart.mean() < 2 * math.sqrt(ratio)
    assert apart.mean() < 0.8 * plain.mean()


@pytest.mark.parametrize(
    ("changed", "message"),
    [
        ({"poses": torch.full((2, 4, 3), torch.nan).double()}, "not finite"),
        ({"sizes": torch.zeros(4, 2).double()}, "a size that is not"),
        ({"poses": torch.zeros(3, 4, 3).double()}, "3 views and 2 cameras"),
        (
            {"sizes": torch.ones(3, 2).double()},
            r"sizes has shape \(3, 2\); expected \(views, boxes, 2\) = \(2, 4, 2\)",
        ),
        ({"colours": torch.ones(4, 1).double()}, "1 channels and the ground has 3"),
        ({"heading_colours": torch.ones(4, 1).double()}, "1 channels and the ground has 3"),
        ({"sizes": torch.full((4, 2), torch.inf).double()}, "a size that is not"),
        ({"sizes": torch.ones(4, 2)}, "tensors have dtypes torch.float32, torch.float64"),
        ({"present": torch.ones(3).bool()}, r"present has shape \(3,\)"),
        ({"heading_colours": torch.ones(4, 3)}, "tensors have dtypes torch.float32, torch.float64"),
        ({"poses": torch.zeros(2, 4, 4).double()}, r"poses of shape \(2, 4, 4\)"),
        ({"sizes": torch.ones(4, 3).double()}, r"sizes of shape \(4, 3\)"),
    ],
)
def test_invalid_boxes_are_refused(changed, message, without_shape_checks):
    cameras, boxes = _scene()
    with pytest.raises(ValueError, match=message):
        render(View(8, 8, 1.0), cameras, _ground(), [replace(boxes, **changed)])


def test_view_without_pixels_is_refused():
    for given in ((0, 4, 1.0), (4, 4, 0.0), (4, 4, -1.0), (4, 4, float("nan"))):
        with pytest.raises(ValueError, match="are needed"):
            View(*given)


def test_no_views_are_no_pictures():
    none = render(View(4, 5, 1.0), torch.empty(0, 3), _single(0.0))
    assert none.shape == (0, 3, 4, 5)


def test_second_derivatives_are_refused():
    cameras, boxes = _scene(views=1)
    poses = boxes.poses.clone().requires_grad_()
    picture = render(View(16, 16, 1.0), cameras, _ground(), [replace(boxes, poses=poses)])
    (first,) = torch.autograd.grad(picture.square().sum(), poses, create_graph=True)
    with pytest.raises(RuntimeError, match="once_differentiable"):
        first.sum().backward()


def test_autocast_does_not_change_pictures():
    cameras = _scene(views=1)[0].float()
    waves = _ground()
    ground = make_ground(waves.image[:, 1:-1, 1:-1].float(), NORTH_UP.float())
    plain = render(View(16, 16, 1.0), cameras, prefilter_ground(ground, 1.0))
    with torch.autocast("cpu", torch.bfloat16):
        half = render(View(16, 16, 1.0), cameras, prefilter_ground(ground, 1.0))
    assert torch.equal(half, plain)


def test_camera_that_is_not_finite_is_refused():
    with pytest.raises(ValueError, match="camera's pose is not finite"):
        render(View(8, 8, 1.0), torch.tensor([[0.0, torch.inf, 0.0]]), _single(0.0))


def test_invalid_textures_are_refused(without_shape_checks):
    with pytest.raises(ValueError, match="must be invertible"):
        make_ground(torch.zeros(1, 4, 4), torch.zeros(2, 3))
    with pytest.raises(ValueError, match="pixels that are not finite"):
        make_ground(torch.full((1, 4, 4), torch.nan), NORTH_UP)
    with pytest.raises(ValueError, match=r"mask \(4, 5\)"):
        make_ground(torch.zeros(1, 4, 4), NORTH_UP, coverage=torch.ones(4, 5).bool())


def test_without_boxes_the_picture_is_the_ground():
    none = OrientedBoxes(torch.empty(1, 0, 3), torch.empty(0, 2), torch.empty(0, 3))
    picture = render(View(8, 8, 1.0), torch.zeros(1, 3), _single(0.3), [none])
    torch.testing.assert_close(picture, torch.full_like(picture, 0.3))


def test_layers_rendered_together_equal_those_rendered_alone():
    generator = torch.Generator().manual_seed(0)
    ground, view, cameras = _ground(), View(24, 24, 0.7), torch.tensor([[0.0, 0.0, 0.3]] * 3)
    cameras = cameras.to(ground.image)

    def some(count, triangles, present=None):
        poses = torch.randn(3, count, 3, generator=generator).double() * 3
        sizes = 1 + torch.rand(count, 2, generator=generator).double() * 3
        colours = torch.rand(count, 3, generator=generator).double()
        return OrientedBoxes(poses, sizes, colours, present, colours.flip(0) if triangles else None)

    there = torch.tensor([[True, False, True, True]] * 2 + [[False] * 4])
    layers = [
        some(5, triangles=True),
        some(4, triangles=False, present=there),
        some(2, triangles=True),
    ]
    planes = render_layers(view, cameras, ground, layers)
    for number, layer in enumerate(layers):
        alone = render_layers(view, cameras, ground, [layer])
        torch.testing.assert_close(planes[:, [0, 1, 2, 3 + number]][:, -1], alone[:, -1])
    picture = render(view, cameras, ground, layers)
    wholly = [replace(layer, present=None) for layer in layers]
    assert not torch.equal(picture, render(view, cameras, ground, wholly))
