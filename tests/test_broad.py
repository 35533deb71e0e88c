"""Broad phase against brute force: no pair missing, none too many, whatever the sizes of the boxes."""

from __future__ import annotations

import numpy as np
import pytest
from stress.penetration import brute

from fdem.kernels.broad import box_pairs


def boxes(n, decades, domain, seed):
    """Boxes whose sizes spread over so many powers of ten."""
    g = np.random.default_rng(seed)
    half = 0.5 * 10.0 ** g.uniform(-decades, 0.0, (n, 1)) * g.uniform(0.2, 1.0, (n, 3))
    centre = g.uniform(0.0, 1.0, (n, 3)) * domain
    return centre - half, centre + half


@pytest.mark.parametrize("decades", [0, 1, 4])
@pytest.mark.parametrize("seed", range(5))
def test_pairs_equal_brute_force(decades, seed):
    lower, upper = boxes(600, decades, 4.0 if decades < 4 else 2.0, seed)
    fixed = (np.random.default_rng(seed).random(600) < 0.3).astype(np.uint8)
    reach = np.full(600, 0.01)
    pairs = box_pairs(lower, upper, reach, fixed)
    np.testing.assert_array_equal(pairs, brute(lower, upper, reach, fixed))
    assert len(pairs) > 20


def test_boxes_on_a_lattice_that_touch_are_pairs():
    """Shared faces on cell borders: the worst place for rounding."""
    lower = np.array(np.meshgrid(*[np.arange(8) / 10.0] * 3)).reshape(3, -1).T.copy()
    pairs = box_pairs(lower, lower + 0.1, np.full(512, 1e-9), np.zeros(512, np.uint8))
    np.testing.assert_array_equal(pairs, brute(lower, lower + 0.1, np.full(512, 1e-9), np.zeros(512, np.uint8)))


def test_far_from_the_origin_and_very_flat():
    lower, upper = boxes(300, 2, 3.0, 3)
    upper[0, :2], lower[0, :2] = 1e4, -1e4  # a wide slab under everything
    lower[1], upper[1] = lower[2], lower[2]  # no extent at all
    shift = np.array([5e5, 4.6e6, 300.0])
    reach, fixed = np.full(300, 1e-3), np.zeros(300, np.uint8)
    pairs = box_pairs(lower + shift, upper + shift, reach, fixed)
    np.testing.assert_array_equal(pairs, brute(lower + shift, upper + shift, reach, fixed))


def test_no_box_and_one_box():
    one = np.zeros((1, 3))
    assert len(box_pairs(one, one + 1.0, np.zeros(1), np.zeros(1, np.uint8))) == 0
    assert len(box_pairs(one[:0], one[:0], np.zeros(0), np.zeros(0, np.uint8))) == 0
