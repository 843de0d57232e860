"""Rigid motions: composition, inverse, relative motion and batching agree with one another."""

from __future__ import annotations

import numpy as np

from tpmscad.rigid_motion import Motion

RNG = np.random.default_rng(3)
N = 5
MOTIONS = Motion(np.linalg.qr(RNG.standard_normal((N, 3, 3)))[0], RNG.standard_normal((N, 3)))
POINTS = RNG.standard_normal((7, 3))


def close(a: np.ndarray, b: np.ndarray) -> None:
    np.testing.assert_allclose(a, b, rtol=0, atol=1e-13)


def test_a_batch_moves_points_as_its_members_do() -> None:
    everywhere = MOTIONS[:, None].apply(POINTS)
    assert everywhere.shape == (N, 7, 3)
    for motion, images in zip(MOTIONS, everywhere, strict=True):
        close(images, motion.apply(POINTS))
    close(MOTIONS.apply(POINTS[:N]), everywhere[np.arange(N), np.arange(N)])


def test_the_inverse_undoes_the_motion() -> None:
    images = MOTIONS[:, None].apply(POINTS)
    close(MOTIONS[:, None].apply_inverse(images), np.broadcast_to(POINTS, images.shape))
    close(MOTIONS[0].apply_inverse(MOTIONS[0].apply(POINTS)), POINTS)


def test_composition_applies_the_inner_motion_first() -> None:
    outer = MOTIONS[2]
    close((outer @ MOTIONS)[:, None].apply(POINTS), outer.apply(MOTIONS[:, None].apply(POINTS)))
    close((MOTIONS @ outer)[:, None].apply(POINTS), MOTIONS[:, None].apply(outer.apply(POINTS)))


def test_a_relative_motion_is_that_seen_from_the_frame() -> None:
    frame = MOTIONS[np.roll(np.arange(N), 1)]
    close((frame[1] @ MOTIONS.relative_to(frame)[1]).apply(POINTS), MOTIONS[1].apply(POINTS))


def test_mirrors_are_left_handed() -> None:
    np.testing.assert_array_equal(MOTIONS.handedness, np.sign(np.linalg.det(MOTIONS.rotation)))
