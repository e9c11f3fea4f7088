"""Local transforms against SciPy's rotations and by hand."""

from __future__ import annotations

import numpy as np
import pytest
from scipy.spatial.transform import Rotation, Slerp

from antdsl.bodies.agents.transforms import (
    ROTATION_ORDERS,
    align_signs,
    angles_to_quaternion,
    compose_matrix,
    decompose_matrix,
    matrix_to_quaternion,
    normalise_quaternion,
    quaternion_to_angles,
    quaternion_to_matrix,
    slerp_quaternions,
)


def test_a_matrix_is_its_parts_again_sheared_and_mirrored_ones_too() -> None:
    matrices = np.random.default_rng(0).normal(size=(500, 4, 4))
    matrices[:, 3] = (0, 0, 0, 1)
    assert np.abs(compose_matrix(*decompose_matrix(matrices)) - matrices).max() < 1e-13
    flat = np.array([np.diag([2.0, 0.0, 3.0, 1.0]), np.diag([0.0, 0.0, 0.0, 1.0])])
    assert np.abs(compose_matrix(*decompose_matrix(flat)) - flat).max() == 0


def test_scale_shear_rotation_and_translation_apply_in_this_order() -> None:
    quarter = angles_to_quaternion(np.array([0.0, 0.0, np.pi / 2]), "xyz")
    matrix = compose_matrix(np.array([0.0, 0.0, 5.0]), quarter, np.array([1.0, 2.0, 1.0]), np.array([0.5, 0.0, 0.0]))
    # (0, 1, 0): scaled to (0, 2, 0), sheared to (1, 2, 0), turned to (-2, 1, 0), moved to (-2, 1, 5)
    assert np.abs(matrix @ (0, 1, 0, 1) - (-2, 1, 5, 1)).max() < 1e-12


@pytest.mark.parametrize("order", ROTATION_ORDERS)
def test_angles_turn_about_the_axes_in_their_order(order: str) -> None:
    angles = np.random.default_rng(1).uniform(-4, 4, (200, 3))
    expected = Rotation.from_euler(order, angles[:, ["xyz".index(letter) for letter in order]]).as_matrix()
    assert np.abs(quaternion_to_matrix(angles_to_quaternion(angles, order)) - expected).max() < 1e-12


def test_rotations_are_matrices_and_angles_again() -> None:
    turns = normalise_quaternion(np.random.default_rng(2).normal(size=(500, 4)))
    locked = angles_to_quaternion(np.array([[0.3, s * np.pi / 2, 0.4] for s in (1, -1)]), "xyz")
    turns = np.concatenate([turns, locked, np.eye(4)])
    matrices = quaternion_to_matrix(turns)
    assert np.abs(matrices - Rotation.from_quat(turns).as_matrix()).max() < 1e-12
    assert np.abs(quaternion_to_matrix(matrix_to_quaternion(matrices)) - matrices).max() < 1e-12
    assert np.abs(quaternion_to_matrix(angles_to_quaternion(quaternion_to_angles(turns), "xyz")) - matrices).max() < 1e-7


def test_between_two_rotations_it_goes_the_short_way_at_an_even_rate() -> None:
    turns = normalise_quaternion(np.random.default_rng(3).normal(size=(60, 4)))
    for a, b in zip(turns[::2], turns[1::2], strict=True):
        expected = Slerp([0, 1], Rotation.from_quat([a, b]))(0.3).as_matrix()
        assert np.abs(quaternion_to_matrix(slerp_quaternions(a, b, np.array(0.3))) - expected).max() < 1e-11
    same = slerp_quaternions(turns, -turns, np.full(60, 0.5))
    assert np.abs(np.abs((same * turns).sum(axis=1)) - 1).max() < 1e-12


def test_rotations_that_follow_each_other_keep_to_one_sign() -> None:
    angles = np.zeros((40, 3))
    angles[:, 2] = np.linspace(0, 20, 40)
    rotations = angles_to_quaternion(angles, "xyz")
    assert ((rotations[1:] * rotations[:-1]).sum(axis=1) > 0).all()
    signs = np.where(np.arange(40) % 3 == 0, -1.0, 1.0)[:, None]
    assert (np.abs(align_signs(rotations * signs) - rotations * signs[0]) == 0).all()
