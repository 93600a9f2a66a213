"""All anchors, tangents and handles of an outline together, fitted to its points by damped Gauss-Newton.

Only distances along the normal count. Joints stay as they are: smooth ones share a direction (that of the line, where
one side is a line), corners do not. Points pass to the neighbouring piece when their foot does.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from cubicsplat_cli.artwork.robust import OUTLYING, huber_weights, outlying_loss
from cubicsplat_cli.artwork.tracing.variables import Pieces, Variables
from cubicsplat_cli.raster.cubics import piece_equations, settled

ROUNDS = 8
ENOUGH = 0.01  # relative gain of a round below which the fit has converged
STIFFNESS = 0.3  # 1/px^2, against steps that the points do not call for
MOST_DENSE = 64  # variables


@dataclass(frozen=True)
class Feet:
    """Where n points belong: piece (n,) int and parameter (n,) in [0, 1]."""

    piece: np.ndarray
    u: np.ndarray


def settle(
    pieces: Pieces, points: np.ndarray, feet: Feet, rounds: int = 2
) -> tuple[Feet, tuple[np.ndarray, np.ndarray]]:
    """The feet of the points, moved on to the neighbouring piece where they left their own, and the signed distances
    (n,) along the normal, px, with the unit normals (n, 2)."""
    piece, u, rest, normals = settled(pieces.cubics, pieces.ends, pieces.smooth, points, feet.piece, feet.u, rounds)
    return Feet(piece, u), (rest, normals)


def refine(pieces: Pieces, points: np.ndarray, weights: np.ndarray, feet: Feet) -> tuple[Pieces, Feet, float]:
    """The pieces nearest to the points, their feet, and chi^2 (with Huber's tails).

    points: (n, 2) px; weights: (n,) 1/px^2.
    """
    pieces = joined_smoothly(pieces)
    feet, (rest, normals) = settle(pieces, points, feet)
    best = outlying_loss(rest, weights)
    damping = 1e-3
    for _ in range(ROUNDS):
        gram, slope = _normal_equations(pieces, feet, rest, normals, weights)
        variables, system, slope = _reduced(pieces, gram, slope)
        improved = False
        for _ in range(4):
            trial = variables.moved(_step(system, slope, damping))
            trial_feet, (trial_rest, trial_normals) = settle(trial, points, feet)
            value = outlying_loss(trial_rest, weights)
            if value < best:
                improved = True
                break
            damping *= 8.0
        if not improved:
            break
        gain = best - value
        pieces, feet, rest, normals, best = trial, trial_feet, trial_rest, trial_normals, value
        damping = max(damping / 5.0, 1e-6)
        if gain < ENOUGH * best + 0.05:
            break
    return pieces, feet, best


def joined_smoothly(pieces: Pieces) -> Pieces:
    """The pieces with the handles at smooth joints turned into one direction, that of the line where there is one."""
    variables = Variables(pieces)
    return variables.moved(np.zeros(variables.total + 1))


def _normal_equations(
    pieces: Pieces, feet: Feet, rest: np.ndarray, normals: np.ndarray, weights: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Gram matrices (S, 8, 8) and gradients (S, 8) over the 8 coordinates of each piece's control points."""
    w = weights * huber_weights(np.abs(rest) * np.sqrt(weights), OUTLYING)
    return piece_equations(len(pieces.lines), feet.piece, feet.u, rest, normals, w)


def _reduced(
    pieces: Pieces, gram: np.ndarray, slope: np.ndarray
) -> tuple[Variables, sparse.csc_matrix | np.ndarray, np.ndarray]:
    """The variables, and the Gram matrix, dense where they are few, and gradient over them."""
    variables, count = Variables(pieces), len(gram)
    if variables.total <= MOST_DENSE:
        own = variables.dense_jacobian()
        weighted = gram @ own.reshape(count, 8, -1)
        return variables, own.T @ weighted.reshape(own.shape), own.T @ slope.ravel()
    jacobian = variables.jacobian()
    blocks = sparse.bsr_matrix((gram, np.arange(count), np.arange(count + 1)), shape=(8 * count, 8 * count))
    return variables, (jacobian.T @ (blocks.tocsr() @ jacobian)).tocsc(), jacobian.T @ slope.ravel()


def _step(system: sparse.csc_matrix | np.ndarray, slope: np.ndarray, damping: float) -> np.ndarray:
    diagonal = system.diagonal()
    added = damping * (diagonal + 1e-4 * diagonal.max(initial=0.0)) + STIFFNESS
    if isinstance(system, np.ndarray):
        return np.append(np.linalg.solve(system + np.diag(added), -slope), 0.0)
    return np.append(splu(system + sparse.diags(added, format="csc")).solve(-slope), 0.0)
