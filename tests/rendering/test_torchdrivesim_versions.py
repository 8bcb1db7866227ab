"""One name serves torchdrivesim 0.2.3 and its next release, by doubles of both interfaces."""

import importlib
import sys

import pytest
import torch

from geoaim.rendering import OrientedBoxes, View, make_ground, prefilter_ground, render
from geoaim.rendering.triangles import paint_triangles
from geoaim.simulation.overlap import compute_box_corners
from tests.rendering.torchdrivesim_doubles import Mesh, Renderer023, RendererNext, install

FOV = 40.0


@pytest.fixture
def find_renderer(monkeypatch):
    def find(version):
        install(monkeypatch, version)
        return importlib.import_module("geoaim.rendering.torchdrivesim").ImageMapRenderer

    yield find
    sys.modules.pop("geoaim.rendering.torchdrivesim", None)


def make_map():
    image = torch.rand(3, 60, 60, generator=torch.Generator().manual_seed(0))
    return make_ground(image, torch.tensor([[1.0, 0, 30], [0, -1.0, 30]]))


def make_cars():
    poses = torch.tensor([[[2.0, 1.0, 0.4], [-6.0, 3.0, 2.0], [2.5, 1.5, 1.0]]])
    return poses, torch.tensor([[4.5, 1.9], [8.0, 2.5], [2.0, 2.0]]), torch.rand(3, 3)


def make_mesh(poses, sizes, colours):
    """Two triangles for each box; later boxes have lower levels."""
    corners = compute_box_corners(poses, sizes[None])  # (1, N, 4, 2)
    count = poses.shape[1]
    levels = torch.arange(count, 0, -1.0).repeat_interleave(4)[None, :, None]
    first = 4 * torch.arange(count)[:, None, None]
    faces = (first + torch.tensor([[0, 1, 2], [0, 2, 3]])).reshape(1, -1, 3)
    verts = torch.cat([corners.flatten(1, 2), levels], dim=2)
    return Mesh(verts, faces, colours.repeat_interleave(4, dim=0)[None])


def test_version_0_2_3_gets_frames(find_renderer):
    renderer = find_renderer(Renderer023)(make_map(), batch_size=1, fov=FOV)
    poses, sizes, _ = make_cars()
    states = {"vehicle": torch.cat([poses, torch.zeros(1, 3, 1)], dim=2)}
    views = renderer.render_frame(states, {"vehicle": sizes[None]})
    assert views.shape == (1, 3, 3, 64, 64)
    assert renderer.expand(2).select_batch_elements(torch.tensor([1])).world_center.shape == (1, 2)


def test_the_next_version_gets_meshes(find_renderer):
    renderer = find_renderer(RendererNext)(make_map(), batch_size=1, device="cpu", fov=FOV)
    poses, sizes, colours = make_cars()
    xy, heading = torch.tensor([[[1.0, -2.0]]]), torch.tensor([[[0.7]]])
    sine_cosine = torch.cat([heading.sin(), heading.cos()], dim=-1)
    views = renderer.copy().render_frame(make_mesh(poses, sizes, colours), xy, sine_cosine)
    view = View(64, 64, FOV / 64)
    ground = prefilter_ground(make_map(), view.resolution)
    boxes = [OrientedBoxes(poses[:, [k]], sizes[k], colours[k]) for k in range(3)]
    ours = render(view, torch.tensor([[1.0, -2.0, 0.7]]), ground, boxes)
    torch.testing.assert_close(views / 255, ours, atol=0.02, rtol=0)  # no seams on diagonals
    empty = Mesh(torch.zeros(1, 0, 3), torch.zeros(1, 0, 3).long(), torch.zeros(1, 0, 3))
    alone = renderer.render_frame(empty, xy, sine_cosine)
    torch.testing.assert_close(alone / 255, render(view, torch.tensor([[1.0, -2, 0.7]]), ground))


def test_triangles_have_the_gradients_of_differences():
    view, cameras = View(6, 6, 1.0), torch.tensor([[0.2, 0.1, 0.3]]).double()
    generator = torch.Generator().manual_seed(1)
    corners = (torch.rand(1, 3, 3, 2, generator=generator).double() * 6 - 3).requires_grad_()
    colours = torch.rand(1, 3, 2, generator=generator).double().requires_grad_()
    pictures = torch.rand(1, 2, 6, 6, generator=generator).double()
    levels = torch.tensor([[2.0, 1.0, 1.0]]).double()

    def paint(corners, colours):
        return paint_triangles(view, cameras, pictures, corners, colours, levels)

    assert torch.autograd.gradcheck(paint, (corners, colours), eps=1e-6, atol=1e-4)
