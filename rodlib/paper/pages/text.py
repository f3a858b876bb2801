"""Markdown with formulas as HTML that needs neither scripts nor fonts: formulas become drawings."""

import re
from functools import cache
from xml.etree import ElementTree

import ziamath
from nbconvert.filters.markdown_mistune import IPythonRenderer, MarkdownWithMath

SIZE = 16  # pixels at which formulas are drawn; on the page they are as large as the text around
ziamath.config.svg2 = False  # glyphs as paths, since two drawings on a page must not share names


@cache
def formula(tex: str, inline: bool = True) -> str:
    """Draw a formula as an SVG element, to stand on the line of the text.

    Parameters
    ----------
    tex : str
        LaTeX, without dollar signs.
    inline : bool
        Whether it stands in a line, or by itself.

    Returns
    -------
    str
        With the LaTeX as its text for who cannot see it.

    Raises
    ------
    ValueError
        If the formula cannot be drawn.
    """
    try:
        drawn = ziamath.Latex(tex.strip(), size=SIZE, color="currentColor", inline=inline)
        element = drawn.svgxml()
    except Exception as error:  # of many kinds
        raise ValueError(f"the formula {tex!r} cannot be drawn: {error}") from error
    _, top, _, height = (float(number) for number in element.attrib["viewBox"].split())
    for name in ("width", "height"):
        element.set(name, f"{float(element.attrib[name]) / SIZE:.4f}em")
    element.set("style", f"vertical-align:{-(top + height) / SIZE:.4f}em")
    element.set("class", "math")
    element.set("role", "img")
    element.set("aria-label", " ".join(tex.split()))
    return ElementTree.tostring(element, encoding="unicode")


class _Renderer(IPythonRenderer):
    """Markdown as HTML; `target` maps the target of a link or of a picture to its place."""

    def __init__(self, target):
        super().__init__(escape=False)
        self.target = target

    def heading(self, text, level, **attrs):
        words = re.sub(
            r'<svg.*?aria-label="([^"]*)".*?</svg>|<[^>]+>', r"\1", text, flags=re.DOTALL
        )
        name = re.sub(r"\W+", "-", words).strip("-").lower()
        link = f'<a class="anchor-link" href="#{name}" aria-label="link to this heading">¶</a>'
        return f'<h{level} id="{name}">{text}{link}</h{level}>\n'

    def inline_math(self, body):
        return formula(body)

    def block_math(self, body):
        return f'<div class="display">{formula(body, inline=False)}</div>'

    def link(self, text, url, title=None):
        return super().link(text, self.target(url), title)

    def image(self, text, url, title=None):
        return super().image(text, self.target(url), title)


def as_html(markdown: str, target) -> str:
    """Markdown, with formulas between dollar signs, as HTML.

    Parameters
    ----------
    markdown : str
    target : callable
        From the target of a link or of a picture to what the page has for it.

    Returns
    -------
    str
    """
    return MarkdownWithMath(renderer=_Renderer(target)).render(markdown)
