import torch

from geoaim.prediction.augmentation import misplace_ground
from geoaim.rendering.ground import world_from_pixels
from tests.prediction.tiny import hill


def test_a_misplaced_map_lies_within_the_given_shift_and_scale():
    ground = hill()
    pixels = torch.tensor([[[0.0, 0.0], [40.0, 0.0], [20.0, 20.0]]])
    before = world_from_pixels(ground.image_from_world, pixels)[0]
    seen = []
    for seed in range(20):
        draws = torch.Generator().manual_seed(seed)
        moved = misplace_ground(ground, 2.0, 0.1, draws)
        after = world_from_pixels(moved.image_from_world, pixels)[0]
        size = (after[1] - after[0]).norm() / (before[1] - before[0]).norm()
        shift = (after[2] - before[2]).norm()
        assert 0.9 <= size <= 1.1
        assert shift <= 2.0 + 1e-4
        seen.append((float(size), float(shift)))
    assert max(size for size, _ in seen) > 1.05 > 0.95 > min(size for size, _ in seen)
    assert max(shift for _, shift in seen) > 1.0
