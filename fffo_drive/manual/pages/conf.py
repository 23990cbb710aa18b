"""Settings of Sphinx for the manual. Everything that a page needs is beside it: no address of a network occurs."""

from __future__ import annotations

import html
from typing import Any

from docutils import nodes
from docutils.utils.math import latex2mathml

from fffo_drive import __version__

project = "fffo_drive"
author = "the authors of fffo_drive"
copyright = "MIT licence"
version = release = __version__

extensions = ["myst_parser", "sphinx_copybutton"]
myst_enable_extensions = ["dollarmath", "deflist", "colon_fence", "attrs_inline"]
myst_heading_anchors = 4
source_suffix = {".md": "markdown"}
exclude_patterns: list[str] = ["configs/*", "scripts/*"]
nitpicky = True
suppress_warnings = ["misc.highlighting_failure"]

html_theme = "furo"
html_title = f"fffo_drive {version}"
html_static_path = ["static"]
html_css_files = ["manual.css"]
html_show_sourcelink = False
html_copy_source = False
html_show_search_summary = False  # it would read pages with fetch(), which browsers refuse to file://
html_show_sphinx = False
html_theme_options: dict[str, Any] = {"top_of_page_buttons": []}
pygments_style = "friendly"
pygments_dark_style = "monokai"
html_math_renderer = "mathml"

copybutton_prompt_text = "$ "
copybutton_only_copy_prompt_lines = True
copybutton_remove_prompts = True


def _mathml(tex: str, block: bool) -> str:
    return str(latex2mathml.tex2mathml(tex, as_block=block))  # type: ignore[no-untyped-call]


def _visit_math(writer: Any, node: nodes.math) -> None:
    writer.body.append(_mathml(node.astext(), block=False))
    raise nodes.SkipNode


def _visit_math_block(writer: Any, node: nodes.math_block) -> None:
    writer.body.append(f'<div class="math" role="math" aria-label="{html.escape(node.astext(), quote=True)}">')
    writer.body.append(_mathml(node.astext(), block=True))
    writer.body.append("</div>\n")
    raise nodes.SkipNode


def setup(app: Any) -> None:
    """Formulas as MathML: browsers draw it by themselves."""
    app.add_html_math_renderer("mathml", (_visit_math, None), (_visit_math_block, None))
