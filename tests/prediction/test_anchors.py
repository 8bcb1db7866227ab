import torch

from geoaim.prediction.anchors import AnchorHead, compute_anchor_loss, select_anchor
from geoaim.prediction.config import Config


def test_proposals_turn_with_the_agent():
    torch.manual_seed(0)
    sizes = {"num_anchors": 4, "anchor_points": 2, "feature_size": 5, "hidden_size": 8}
    head = AnchorHead(Config("pedestrian", "slide", 0.4, history=3, horizon=6, **sizes))
    assert head.steps == [3, 6]
    pose = torch.tensor([[1.0, 2.0, 0.3, 1.5]])
    past, seen = torch.tensor([[[0.0, 1.0], [0.4, 1.5], [1.0, 2.0]]]), torch.rand(1, 5)
    turn = torch.tensor(0.7)
    matrix = torch.stack([turn.cos(), -turn.sin(), turn.sin(), turn.cos()]).view(2, 2)
    turned = torch.cat([pose[:, :2] @ matrix.t(), pose[:, 2:3] + turn, pose[:, 3:]], dim=1)
    one, likely = head(pose, past, seen)
    other, same = head(turned, past @ matrix.t(), seen)
    assert one.shape == (1, 4, 2, 2)
    assert torch.allclose(one @ matrix.t(), other, atol=1e-5)
    assert torch.allclose(likely, same, atol=1e-5)


def test_only_the_best_proposals_are_trained():
    target = torch.zeros(1, 2, 2)
    anchors = torch.tensor([3.0, 1.0, 2.0]).view(1, 3, 1, 1).expand(1, 3, 2, 2).clone()
    anchors.requires_grad_()
    for top_k, trained in ((1, [1]), (2, [1, 2]), (3, [0, 1, 2])):
        anchors.grad = None
        compute_anchor_loss(anchors, torch.zeros(1, 3), target, top_k).backward()
        assert anchors.grad.abs().sum(dim=(0, 2, 3)).nonzero()[:, 0].tolist() == trained
    right, wrong = torch.tensor([[0.0, 5, 0]]), torch.tensor([[5.0, 0, 0]])
    assert compute_anchor_loss(anchors, right, target, 1) < compute_anchor_loss(
        anchors, wrong, target, 1
    )


def test_samples_follow_the_likeliest_proposals_first():
    anchors = torch.arange(3.0).view(1, 3, 1, 1).expand(4, 3, 1, 2)
    logits = torch.tensor([[0.0, 2.0, 1.0]]).expand(4, 3)
    points = select_anchor(anchors, logits, torch.arange(4))
    assert points[:, 0, 0].tolist() == [1, 2, 0, 1]
