import torch

from geoaim.prediction.plans import Planner, nth_plan, plan_loss


def test_plans_turn_with_who_makes_them():
    torch.manual_seed(0)
    planner = Planner(known=3, ahead=6, modes=4, points=2, features=5, width=8)
    assert planner.steps == [3, 6]
    pose = torch.tensor([[1.0, 2.0, 0.3, 1.5]])
    past, seen = torch.tensor([[[0.0, 1.0], [0.4, 1.5], [1.0, 2.0]]]), torch.rand(1, 5)
    turn = torch.tensor(0.7)
    matrix = torch.stack([turn.cos(), -turn.sin(), turn.sin(), turn.cos()]).view(2, 2)
    turned = torch.cat([pose[:, :2] @ matrix.t(), pose[:, 2:3] + turn, pose[:, 3:]], dim=1)
    one, likely = planner(pose, past, seen)
    other, same = planner(turned, past @ matrix.t(), seen)
    assert one.shape == (1, 4, 2, 2)
    assert torch.allclose(one @ matrix.t(), other, atol=1e-5)
    assert torch.allclose(likely, same, atol=1e-5)


def test_best_plans_alone_learn():
    way = torch.zeros(1, 2, 2)
    plans = torch.tensor([3.0, 1.0, 2.0]).view(1, 3, 1, 1).expand(1, 3, 2, 2).clone()
    plans.requires_grad_()
    for winners, learning in ((1, [1]), (2, [1, 2]), (3, [0, 1, 2])):
        plans.grad = None
        plan_loss(plans, torch.zeros(1, 3), way, winners).backward()
        assert plans.grad.abs().sum(dim=(0, 2, 3)).nonzero()[:, 0].tolist() == learning
    right, wrong = torch.tensor([[0.0, 5, 0]]), torch.tensor([[5.0, 0, 0]])
    assert plan_loss(plans, right, way, 1) < plan_loss(plans, wrong, way, 1)


def test_samples_follow_the_likeliest_plans_first():
    plans = torch.arange(3.0).view(1, 3, 1, 1).expand(4, 3, 1, 2)
    logits = torch.tensor([[0.0, 2.0, 1.0]]).expand(4, 3)
    found = nth_plan(plans, logits, torch.arange(4))
    assert found[:, 0, 0].tolist() == [1, 2, 0, 1]
