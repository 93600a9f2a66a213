"""Red paths on white, sampled finely as drawing programs do, for the tests of regular outlines."""

from __future__ import annotations

import numpy as np
from scipy.sparse import csr_array

from cubicsplat_cli.evaluate.rerender import rerender
from cubicsplat_cli.raster.sparse import SparseRows

RED = (204, 34, 0, 255)
FINE = 8  # samples of a pixel along each side


def red_picture(path: str, places: list[str], width: int, height: int) -> np.ndarray:
    """(H, W, 4) float32 in [0, 1]: a path, once for each transform."""
    text = f'<svg xmlns="http://www.w3.org/2000/svg" width="{width}" height="{height}" viewBox="0 0 {width} {height}">'
    text += '<rect width="100%" height="100%" fill="#fff"/>'
    text += "".join(f'<path d="{path}" transform="{place}" fill="#c20"/>' for place in places) + "</svg>"
    fine = rerender(text.encode(), width * FINE, height * FINE, renderer="resvg").pixels.astype(float)
    levels = np.rint(fine.reshape(height, FINE, width, FINE, 4).mean(axis=(1, 3)))
    return (levels / 255.0).astype(np.float32)


def red_outline(drawing):
    """The outline of the one red shape."""
    (red,) = (shape for shape in drawing.shapes if shape.fill == RED)
    return red.outlines[0]


def dense(matrix: SparseRows) -> np.ndarray:
    """All values of a matrix, (rows, columns)."""
    return csr_array((matrix.values, matrix.columns, matrix.starts), matrix.shape).toarray()


def assert_jacobian(parameters) -> None:
    """An outline's parameters have the Jacobian of finite differences."""
    jacobian = dense(parameters.jacobian)
    for i, step in enumerate(1e-5 * np.eye(jacobian.shape[1])):
        change = (parameters.moved(step).cubics - parameters.moved(-step).cubics).ravel() / 2e-5
        assert np.allclose(change, jacobian[:, i], atol=2e-3)
