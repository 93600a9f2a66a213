"""Quality of the SVG file: drawn by an independent renderer and compared by standard metrics.

The renderers are imported by the functions that need them.
"""

from cubicsplat_cli.evaluate.metrics import compare, compare_premultiplied
from cubicsplat_cli.evaluate.rerender import Rendered, available_renderers, rerender, rerender_untrusted

__all__ = [
    "Rendered", "available_renderers", "compare", "compare_premultiplied", "rerender",
    "rerender_untrusted",
]  # fmt: skip
