"""How good the SVG file is: drawn by a renderer that is not ours, compared by the measures that everybody uses.

The renderers are imported by the functions that need them.
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
