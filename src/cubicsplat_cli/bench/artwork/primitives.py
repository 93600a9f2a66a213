"""Primitives: how many of the truth's the file has as such, and how many of the file's the truth has."""

from __future__ import annotations

import numpy as np
from skimage.draw import polygon2mask

from cubicsplat_cli.bench.artwork.document import Document
from cubicsplat_cli.bench.artwork.pieces import LEAST_SEEN, Pieces
from cubicsplat_cli.bench.artwork.shapes import Form, forms_of

SEEN = 0.5  # share of a primitive that must show
PLACE, PLACE_SHARE = 0.5, 0.01  # px, and share of its size, that each side of the box around a primitive may be off


def primitive_counts(truth: Document, pieces: Pieces, made: Document) -> tuple[int, int, int, int]:
    """(found, wanted, right, written): of the truth's primitives that show for the greater part those which the file
    has written as such; and of the file's those which some outline of the truth is.

    Primitives are circles and ellipses, rectangles, rounded rectangles; in the truth also where they are written as
    paths. Two are the same if they are of one kind and the boxes around them agree.
    """
    forms, own = forms_of(truth), [form for form in forms_of(made) if form.written]
    size = np.array([truth.width, truth.height], dtype=float)
    wanted = [form for form in forms if form.kind and _seen(form, pieces)]
    boxes = [(form.kind, box) for form in own for box in _boxes(form, size)]
    found = sum(any(_same(form.kind, box, *other) for box in _boxes(form, size) for other in boxes) for form in wanted)
    known = [(form.kind, box) for form in forms if form.kind for box in _boxes(form, size)]
    right = sum(any(_same(form.kind, box, *other) for box in _boxes(form, size) for other in known) for form in own)
    return found, len(wanted), right, len(own)


def _seen(form: Form, pieces: Pieces) -> bool:
    mask = polygon2mask(pieces.shape, form.points[:, ::-1] - 0.5)
    seen = int((mask & (pieces.element == form.element)).sum())
    return seen >= LEAST_SEEN and seen >= SEEN * mask.sum()


def _boxes(form: Form, size: np.ndarray) -> list[np.ndarray]:
    """(4,) left, top, right, bottom on the canvas; of a stroke those of its outer and its inner edge too."""
    low, high = form.points.min(axis=0), form.points.max(axis=0)
    half = 0.5 * form.width
    offsets = (0.0, half, -half) if half else (0.0,)
    return [np.clip([low - o, high + o], 0.0, size).ravel() for o in offsets]


def _same(kind: str, box: np.ndarray, other_kind: str, other: np.ndarray) -> bool:
    allowed = PLACE + PLACE_SHARE * float((box[2:] - box[:2]).max())
    return kind == other_kind and bool(np.abs(box - other).max() <= allowed)
