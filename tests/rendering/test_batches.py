"""Batches of views: several maps, several views a scene, threads, broadcasting, and modules."""

from dataclasses import replace

import pytest
import torch
from torch.autograd import forward_ad

from geoaim.base.errors import GeoaimWarning
from geoaim.rendering import (
    OrientedBoxes,
    Renderer,
    View,
    collate_boxes,
    make_ground,
    make_path_boxes,
    prefilter_ground,
    render,
    render_coverage,
    render_layers,
    stack_grounds,
)

VIEW = View(24, 20, 0.7)
PARTS = slice(0, 1), slice(1, 3)


def noise(seed=0):
    return torch.Generator().manual_seed(seed)


def make_maps(count=3):
    """Maps of different sizes and directions."""
    maps = []
    for k in range(count):
        image = torch.rand(3, 30 + 9 * k, 50 - 7 * k, generator=noise(k))
        matrix = torch.tensor([[1.3, 0.2 * k, 20.0 + k], [0.2 * k, -1.3, 17.0]])
        maps.append(make_ground(image, matrix))
    return maps


def make_boxes(views=4, count=5, seed=1):
    random = torch.rand(views, count, 6, generator=noise(seed))
    poses = torch.cat([random[..., :2] * 16 - 8, random[..., 2:3] * 6], dim=2)
    colours = random[..., 3:]
    return OrientedBoxes(poses, torch.tensor([4.0, 2.0]), colours, heading_colours=1 - colours)


def make_cameras(views=4):
    random = torch.rand(views, 3, generator=noise(7))
    return random * torch.tensor([8.0, 8.0, 6.0]) - torch.tensor([4.0, 4.0, 0.0])


@pytest.mark.parametrize("resolution", [None, 3.0])
def test_views_of_stacked_maps_are_those_of_each_map(resolution):
    maps, cameras, boxes = make_maps(), make_cameras(), make_boxes()
    if resolution is not None:
        maps = [prefilter_ground(ground, resolution) for ground in maps]
    index = torch.tensor([2, 0, 1, 2])
    stacked = stack_grounds(maps).select(index)
    picture = render(VIEW, cameras, stacked, [boxes])
    coverage = render_coverage(VIEW, cameras, stacked)
    for k, number in enumerate(index):
        one = replace(boxes, poses=boxes.poses[k : k + 1], colours=boxes.colours[k : k + 1])
        one = replace(one, heading_colours=boxes.heading_colours[k : k + 1])
        camera = cameras[k : k + 1]
        alone = render(VIEW, camera, maps[number], [one])
        torch.testing.assert_close(picture[k : k + 1], alone, atol=2e-5, rtol=0)
        alone = render_coverage(VIEW, camera, maps[number])
        torch.testing.assert_close(coverage[k : k + 1], alone, atol=2e-5, rtol=0)


def test_prefiltered_stack_is_the_stack_of_prefiltered_maps():
    one = prefilter_ground(stack_grounds(make_maps()), 3.0)
    two = stack_grounds([prefilter_ground(ground, 3.0) for ground in make_maps()])
    assert torch.equal(one.image, two.image)
    torch.testing.assert_close(one.image_from_world, two.image_from_world)


def test_stack_has_gradients_by_each_texture():
    images = [torch.rand(3, 20, 20).double().requires_grad_() for _ in range(2)]
    matrix = torch.tensor([[1.0, 0, 10], [0, -1, 10]]).double()
    ground = stack_grounds([make_ground(image, matrix) for image in images])
    picture = render(View(4, 4, 1.0), torch.zeros(1, 3).double(), ground.select(torch.tensor([1])))
    grads = torch.autograd.grad(picture.sum(), images)
    assert not grads[0].any()
    assert grads[1].sum() == pytest.approx(3 * 16)


def test_a_batch_of_textures_is_one_ground():
    images = torch.rand(3, 3, 20, 24, generator=noise())
    matrices = torch.tensor([[1.0, 0, 9], [0, -1, 8], [0, 0, 1]]).repeat(3, 1, 1)
    covered = torch.rand(3, 20, 24, generator=noise(1)) > 0.5
    batch = make_ground(images, matrices, coverage=covered)
    alone = [make_ground(images[k], matrices[k], coverage=covered[k]) for k in range(3)]
    cameras = make_cameras(3)
    for draw in (render, render_coverage):
        expected = torch.cat([draw(VIEW, cameras[k : k + 1], g) for k, g in enumerate(alone)])
        torch.testing.assert_close(draw(VIEW, cameras, batch), expected, atol=2e-5, rtol=0)
    with pytest.raises(ValueError, match="3 maps for 2 views"):
        render(VIEW, cameras[:2], batch)
    with pytest.raises(ValueError, match="its last row must be 0, 0, 1"):
        make_ground(images, matrices + 0.1)


def test_other_numbers_of_textures_and_transforms_are_refused(unchecked):
    with pytest.raises(ValueError, match="3 textures, 2 transforms"):
        make_ground(torch.rand(3, 3, 4, 4), torch.eye(3).expand(2, 3, 3))


def test_grounds_that_differ_are_not_stacked():
    one, *_ = make_maps()
    for other in (one.to(dtype=torch.float64), prefilter_ground(one, 3.0)):
        with pytest.raises(ValueError, match="the grounds differ"):
            stack_grounds([one, other])
    with pytest.raises(ValueError, match="no ground was given"):
        stack_grounds([])


def test_views_of_one_scene_share_its_boxes():
    ground, boxes = stack_grounds(make_maps()[:2]), make_boxes(2)
    cameras = make_cameras(6).view(2, 3, 3).requires_grad_()
    poses = boxes.poses.clone().requires_grad_()
    present = torch.tensor([[True, False, True], [True, True, False]])
    lost = torch.where(present[..., None], cameras, torch.nan)
    picture = render(VIEW, lost, ground, [replace(boxes, poses=poses)], present=present)
    assert picture.shape == (2, 3, 3, 24, 20)
    assert not picture[~present].any()
    repeated = [t.repeat_interleave(3, 0) for t in (poses, boxes.colours, boxes.heading_colours)]
    flat = OrientedBoxes(repeated[0], boxes.sizes, repeated[1], heading_colours=repeated[2])
    each = ground.select(torch.tensor([0, 0, 0, 1, 1, 1]))
    expected = render(VIEW, cameras.flatten(0, 1), each, [flat]).view_as(picture)
    torch.testing.assert_close(picture[present], expected[present])
    one, two = (
        torch.autograd.grad((p[present] ** 2).sum(), (poses, cameras)) for p in (picture, expected)
    )
    for a, b in zip(one, two, strict=True):
        torch.testing.assert_close(a.nan_to_num(), b, atol=1e-3, rtol=1e-4)
    planes = render_layers(VIEW, lost, ground, [boxes, boxes], present=present)
    assert planes.shape == (2, 3, 5, 24, 20)
    assert not planes[~present].any()


def test_a_mask_of_another_shape_is_refused(unchecked):
    with pytest.raises(ValueError, match="one truth value for each camera"):
        render(VIEW, torch.zeros(2, 3, 3), make_maps(1)[0], present=torch.ones(3).bool())


def test_colours_sizes_and_presence_broadcast():
    ground, boxes = make_maps(1)[0], make_boxes()
    full = replace(
        boxes, sizes=boxes.sizes.expand(4, 5, 2), present=torch.ones(4, 5, dtype=torch.bool)
    )
    red = torch.tensor([1.0, 0.0, 0.0])
    expected = render(VIEW, make_cameras(), ground, [replace(full, colours=red.expand(4, 5, 3))])
    for colours in (red, red[None], red.expand(5, 3), red.expand(1, 5, 3), red.expand(4, 1, 3)):
        one = replace(boxes, colours=colours, present=torch.ones(5, dtype=torch.bool))
        picture = render(VIEW, make_cameras(), ground, (layer for layer in [one]))
        torch.testing.assert_close(picture, expected)
        assert picture.is_contiguous()


def test_gradients_by_what_is_shared_are_summed():
    ground, boxes, cameras = make_maps(1)[0], make_boxes(), make_cameras()
    shared = [boxes.sizes, torch.tensor([0.2, 0.5, 0.9])]
    full = [boxes.sizes.expand(4, 5, 2), shared[1].expand(4, 5, 3)]
    grads = []
    for values in (shared, full):
        sizes, colours = (value.clone().requires_grad_() for value in values)
        layer = replace(boxes, sizes=sizes, colours=colours)
        loss = render(VIEW, cameras, ground, [layer]).square().sum()
        grads.append(torch.autograd.grad(loss, (sizes, colours)))
    for one, many in zip(*grads, strict=True):
        torch.testing.assert_close(one, many.sum(dim=(0, 1)), atol=1e-3, rtol=1e-4)


def test_threads_change_nothing(monkeypatch):
    maps, boxes, cameras = make_maps(1)[0], make_boxes(12), make_cameras(12)
    view, threads = View(160, 160, 0.1), torch.get_num_threads()
    results = []
    for count in (1, 3):
        torch.set_num_threads(count)
        poses, image = boxes.poses.clone().requires_grad_(), maps.image.clone().requires_grad_()
        ground = replace(maps, image=image)
        picture = render(view, cameras, ground, [replace(boxes, poses=poses)])
        results.append((picture, *torch.autograd.grad(picture.square().sum(), (poses, image))))
    torch.set_num_threads(threads)
    for one, other in zip(*results, strict=True):
        torch.testing.assert_close(one, other, atol=1e-4, rtol=1e-4)


def test_many_boxes_on_one_spot_are_their_mean_without_the_ground():
    ground, camera = make_maps(1)[0], torch.zeros(1, 3)
    random = torch.rand(1, 60, 6, generator=noise(3))
    boxes = OrientedBoxes(random[..., :3] * 0.3, torch.tensor([12.0, 10.0]), random[..., 3:])
    picture = render(View(24, 24, 0.5), camera, ground, [boxes])[0]
    mean = boxes.colours[0].mean(dim=0)
    torch.testing.assert_close(picture[:, 12, 12], mean, atol=1e-5, rtol=0)
    plane = render_layers(View(24, 24, 0.5), camera, ground, [boxes])[0, 3]
    assert plane.max() <= 1 + 1e-6


def test_half_precision_is_refused():
    ground = make_maps(1)[0]
    for dtype in (torch.float16, torch.bfloat16):
        with pytest.raises(ValueError, match=f"tensors of {dtype}, in which positions"):
            render(VIEW, make_cameras().to(dtype), ground.to(dtype=dtype))


def test_transforms_of_torch_func_are_refused():
    ground, boxes, cameras = make_maps(1)[0], make_boxes(1), make_cameras(1)

    def draw(poses):
        return render(VIEW, cameras, ground, [replace(boxes, poses=poses)]).sum()

    with pytest.raises(RuntimeError):
        torch.func.vmap(draw)(boxes.poses[None])
    with pytest.raises(RuntimeError):
        torch.func.grad(torch.func.grad(lambda x: draw(boxes.poses + x)))(torch.tensor(0.0))


@pytest.mark.filterwarnings("ignore:.torch.jit.script. is deprecated:DeprecationWarning")
def test_forward_mode_derivatives_are_refused():
    ground, boxes, cameras = make_maps(1)[0], make_boxes(1), make_cameras(1)
    with forward_ad.dual_level():
        for pair in ((cameras, boxes.poses), (boxes.poses, cameras)):
            dual = forward_ad.make_dual(pair[0], torch.ones_like(pair[0]))
            camera, poses = (dual, pair[1]) if pair[0] is cameras else (pair[1], dual)
            with pytest.raises(RuntimeError):
                render(VIEW, camera, ground, [replace(boxes, poses=poses)])


def test_a_plain_colour_is_plain():
    colour = torch.tensor([0.1, 0.6, 0.3])
    ground = make_ground(colour[:, None, None], torch.eye(3))
    for one in (ground, prefilter_ground(ground, 2.0)):
        picture = render(VIEW, make_cameras(), one)
        torch.testing.assert_close(picture, colour[:, None, None].expand_as(picture))


def test_plain_colours_of_several_maps_are_plain():
    colours = torch.rand(3, 3, 1, 1, generator=noise())
    ground = make_ground(colours, torch.eye(3).expand(3, 3, 3))
    picture = render(VIEW, torch.zeros(3, 3), ground)
    torch.testing.assert_close(picture, colours.expand_as(picture))


@pytest.mark.parametrize("shape", [(0, 3), (0, 2, 3), (2, 0, 3)])
def test_a_batch_without_views_has_gradients(shape):
    ground, cameras = make_maps(1)[0], torch.zeros(shape, requires_grad=True)
    one, other = make_boxes(shape[0], 2), make_boxes(shape[0], 3)
    sizes, poses = torch.ones(2, requires_grad=True), one.poses.clone().requires_grad_()
    layers = [replace(one, poses=poses, sizes=sizes), replace(other, colours=torch.ones(3))]
    picture = render(VIEW, cameras, ground, layers)
    assert picture.shape == (*shape[:-1], 3, 24, 20)
    grads = torch.autograd.grad(picture.sum(), (cameras, poses, sizes))
    assert [grad.shape for grad in grads] == [cameras.shape, poses.shape, sizes.shape]


def test_no_boxes_have_gradients():
    boxes = make_boxes(2, 0)
    leaves = [
        leaf.clone().requires_grad_() for leaf in (boxes.poses, torch.ones(0, 2), boxes.colours[:1])
    ]
    layer = OrientedBoxes(*leaves)
    cameras = make_cameras(6).view(2, 3, 3)
    render(VIEW, cameras, make_maps(1)[0], [layer]).sum().backward()
    assert all(leaf.grad.shape == leaf.shape for leaf in leaves)


def test_masks_of_numbers_are_refused(unchecked):
    ground, cameras, boxes = make_maps(1)[0], make_cameras(), make_boxes()
    for dtype in (torch.uint8, torch.float32):
        mask = torch.ones(4, 5, dtype=dtype)
        with pytest.raises(ValueError, match="convert the mask by"):
            render(VIEW, cameras, ground, [replace(boxes, present=mask)])
        for draw in (render, render_coverage):
            with pytest.raises(ValueError, match="convert the mask by"):
                draw(VIEW, cameras, ground, present=mask[:, 0])


def test_a_mask_that_changes_after_the_picture_does_not_change_gradients():
    ground, boxes = make_maps(1)[0], make_boxes(2)
    cameras = make_cameras(4).view(2, 2, 3).requires_grad_()
    present = torch.tensor([[True, True], [True, False]])
    loss = render(VIEW, cameras, ground, [boxes], present=present).square().sum()
    (before,) = torch.autograd.grad(loss, cameras, retain_graph=True)
    present.logical_not_()
    torch.testing.assert_close(torch.autograd.grad(loss, cameras)[0], before)


def test_coverage_checks_its_inputs():
    stacked, cameras = stack_grounds(make_maps(2)), make_cameras(4)
    with pytest.raises(ValueError, match="2 maps for 4 views"):
        render_coverage(VIEW, cameras, stacked)
    ground = make_maps(1)[0]
    with pytest.raises(ValueError, match="camera's pose is not finite"):
        render_coverage(VIEW, cameras * torch.nan, ground)
    with pytest.raises(ValueError, match="positions are off"):
        render_coverage(VIEW, cameras.half(), ground.to(dtype=torch.float16))
    present = torch.tensor([[True, False], [True, True]])
    lost = torch.where(present[..., None], cameras.view(2, 2, 3), torch.nan)
    coverage = render_coverage(VIEW, lost, ground, present=present)
    expected = render_coverage(VIEW, cameras, ground).view(2, 2, 1, 24, 20)
    assert torch.equal(coverage[present], expected[present])
    assert not coverage[~present].any()


def test_maps_far_from_their_origin_need_float64():
    image = torch.rand(3, 8, 8, generator=noise())
    matrix = torch.tensor([[2.0, 0.0, -1e6], [0.0, -2.0, 1e7]])
    place = matrix.double().requires_grad_()
    assert make_ground(image.double(), place).image_from_world.requires_grad
    with pytest.raises(ValueError, match=r"steps of 1\.2 pixels; subtract an origin"):
        make_ground(image, matrix)


def test_paths_have_colours_in_each_view():
    points = torch.tensor([[[-4.0, 0.0], [4.0, 0.0]]]).expand(2, 1, 2, 2)
    colours = torch.eye(3)[:2, None]  # (2 views, 1 path, 3)
    paths = make_path_boxes(points, colours, width=2.0)
    dark = make_ground(torch.zeros(3, 1, 1), torch.eye(3))
    picture = render(VIEW, torch.zeros(2, 3), dark, [paths])
    assert picture[:, :, 12, 10].tolist() == [[1, 0, 0], [0, 1, 0]]


def test_collated_boxes_are_drawn_as_those_of_each_scene():
    ground, cameras = make_maps(1)[0], make_cameras(3)
    parts = [make_boxes(1, 2), make_boxes(2, 4)]
    parts[1] = replace(parts[1], present=torch.rand(2, 4, generator=noise()) > 0.5)
    both = render(VIEW, cameras, ground, [collate_boxes(parts)])
    first, rest = (render(VIEW, cameras[k], ground, [parts[i]]) for i, k in enumerate(PARTS))
    torch.testing.assert_close(both, torch.cat([first, rest]))
    with pytest.raises(ValueError, match="heading_colours or none"):
        collate_boxes([parts[0], replace(parts[1], heading_colours=None)])
    moved = parts[1].to(dtype=torch.float64)
    assert (moved.poses.dtype, moved.present.dtype) == (torch.float64, torch.bool)


def test_a_module_keeps_its_maps():
    maps, cameras, boxes = make_maps(2), make_cameras(), make_boxes()
    ground, index = stack_grounds(maps), torch.tensor([0, 1, 1, 0])
    module = Renderer(VIEW, ground)
    expected = prefilter_ground(ground, VIEW.resolution).select(index)
    picture = module(cameras, [boxes], maps=index)
    torch.testing.assert_close(picture, render(VIEW, cameras, expected, [boxes]))
    planes = Renderer(VIEW, ground, planes=True).double()
    args = cameras.double(), [boxes.to(dtype=torch.float64)]
    assert planes(*args, maps=index).shape == (4, 4, 24, 20)
    assert not module.state_dict()


def test_a_ground_that_does_not_fit_its_image_is_refused():
    ground = make_maps(1)[0]
    for wrong in (
        {"regions": ground.regions + 1},
        {"image_from_world": ground.image_from_world * torch.nan},
    ):
        with pytest.raises(ValueError, match="image_from_world is not finite, or its regions"):
            replace(ground, **wrong)


def test_any_leading_axes_are_flattened():
    torch.manual_seed(3)
    ground = make_ground(torch.rand(3, 40, 40), torch.tensor([[2.0, 0, 20], [0, -2.0, 20]]))
    view, white = View(16, 16, 1.0), torch.ones(3)
    cameras, poses = torch.randn(2, 3, 4, 3), torch.randn(2, 3, 5, 3) * 4
    present = torch.rand(2, 3, 5) > 0.3
    sizes = torch.rand(2, 3, 5, 2) + 1
    pictures = render(view, cameras, ground, [OrientedBoxes(poses, sizes, white, present)])
    assert pictures.shape == (2, 3, 4, 3, 16, 16)
    for i, k in ((0, 2), (1, 0)):
        boxes = OrientedBoxes(poses[i, k][None], sizes[i, k], white, present[i, k])
        one = render(view, cameras[i, k][None], ground, [boxes])[0]
        torch.testing.assert_close(pictures[i, k], one)
    single = OrientedBoxes(poses[0, 0], sizes[0, 0], white, present[0, 0])
    torch.testing.assert_close(render(view, cameras[0, 0, 1], ground, [single]), pictures[0, 0, 1])
    some = torch.rand(2, 3, 4) > 0.5
    masked = render(view, cameras, ground, present=some)
    assert masked[~some].abs().max() == 0


def test_colours_from_0_to_255_are_refused():
    with pytest.raises(ValueError, match="values up to 200; colours are from 0 to 1"):
        make_ground(torch.full((3, 4, 4), 200.0), torch.eye(3))


def test_a_view_that_aliases_is_named():
    fine = make_ground(torch.rand(3, 64, 64), torch.tensor([[8.0, 0, 32], [0, -8.0, 32]]))
    with pytest.warns(GeoaimWarning, match=r"pixels of 0.125 m and the view of 1 m.*prefilter_g"):
        render(View(8, 8, 1.0), torch.zeros(1, 3), fine)
    render(View(8, 8, 1.0), torch.zeros(1, 3), prefilter_ground(fine, 1.0))
    render(View(8, 8, 0.2), torch.zeros(1, 3), fine)
