import numpy as np
import shapely
import torch

from geoaim.simulation.overlap import box_iou, compute_box_corners, compute_intersection_area


def _pairs(count=4000):
    """Random pairs, equal boxes, boxes in line and at right angles."""
    generator = torch.Generator().manual_seed(0)
    poses = torch.rand(count, 2, 3, generator=generator, dtype=torch.float64) * 4
    sizes = torch.rand(count, 2, 2, generator=generator, dtype=torch.float64) * 4 + 0.5
    poses[:1000, 1] = poses[:1000, 0]
    sizes[:500, 1] = sizes[:500, 0]
    poses[1000:1500, 1, 2] = poses[1000:1500, 0, 2]
    poses[1500:2000, 1, 2] = poses[1500:2000, 0, 2] + np.pi / 2
    return poses, sizes


def _compute_with_shapely(poses, sizes):
    polygons = shapely.polygons(compute_box_corners(poses, sizes).numpy())
    shared = shapely.area(shapely.intersection(polygons[:, 0], polygons[:, 1]))
    return shared, shared / (sizes.prod(-1).sum(1).numpy() - shared)


def test_overlap_agrees_with_shapely():
    poses, sizes = _pairs()
    _, expected = _compute_with_shapely(poses, sizes)
    for dtype in (torch.float64, torch.float32):
        iou = box_iou(poses.to(dtype), sizes.to(dtype), torch.ones(len(poses), 2).bool())
        assert np.abs(iou[:, 0, 1].double().numpy() - expected).max() < 1e-5


def test_overlap_does_not_depend_on_where_it_is():
    poses, sizes = (x.float() for x in _pairs())
    far = poses + torch.tensor([4000.0, -3000.0, 0.0])
    apart = compute_intersection_area(far, sizes) - compute_intersection_area(poses, sizes)
    assert apart.abs().max() < 0.01  # float32 places are half a millimetre apart there


def test_overlap_has_right_gradients():
    poses, sizes = (x[2000:2020].clone().requires_grad_() for x in _pairs())
    assert torch.autograd.gradcheck(compute_intersection_area, (poses, sizes))


def test_absent_and_distant_agents_do_not_overlap():
    poses = torch.tensor([[[0.0, 0, 0], [1.0, 0, 0], [torch.nan] * 3, [50.0, 0, 0]]])
    sizes = torch.tensor([4.0, 2.0]).expand(1, 4, 2)
    present = torch.tensor([[True, True, False, True]])
    iou = box_iou(poses, sizes, present)[0]
    assert torch.isfinite(iou).all()
    torch.testing.assert_close(iou[0, 1], torch.tensor(6 / 10), atol=1e-5, rtol=0)
    torch.testing.assert_close(iou, iou.t())
    assert iou.count_nonzero() == 2


def test_overlap_of_nearly_equal_boxes_is_smooth():
    """In float32, edges that nearly coincide would not cancel."""
    generator = torch.Generator().manual_seed(0)
    base = torch.rand(2000, 1, 3, generator=generator) * torch.tensor([80.0, 80.0, 6.28])
    nudge = torch.randn(2000, 1, 3, generator=generator) * 1e-6
    poses = torch.cat([base, base + nudge], dim=1).requires_grad_()
    sizes = torch.tensor([4.5, 1.9]).expand(2000, 2, 2)
    iou = box_iou(poses, sizes, torch.ones(2000, 2).bool())[:, 0, 1]
    (gradient,) = torch.autograd.grad(iou.sum(), poses)
    assert iou.max() <= 1
    assert iou.min() > 0.999
    assert gradient.abs().max() < 2
