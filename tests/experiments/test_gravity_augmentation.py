"""What choosing near the boundary saves, as a ratio of labels."""

import numpy as np

from experiments.gravity_augmentation import ratios_of


def test_the_ratio_is_of_labels_near_the_boundary_to_random_ones():
    reached = {"boundary": 100, "random": 400, "boundary, states": 50, "random, states": np.inf}
    rows = [{"strategy": k, "accuracy": 0.98, "labels": v} for k, v in reached.items()]
    assert ratios_of(rows, (0.98,)) == {"0.98": 0.25, "0.98, states": None}
