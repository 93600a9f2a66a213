"""How good the SVG file is: rendered by a renderer that is not ours, compared by measures that are not ours.

Importing this package is cheap; the renderers and scikit-image are imported by the functions that need them.
"""

from cubicsplat_cli.evaluate.metrics import agreement_db, compare, compare_premultiplied
from cubicsplat_cli.evaluate.rerender import Rendered, available_renderers, rerender, rerender_untrusted

__all__ = [
    "Rendered",
    "agreement_db",
    "available_renderers",
    "compare",
    "compare_premultiplied",
    "rerender",
    "rerender_untrusted",
]
