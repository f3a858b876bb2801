"""Save and show figures; their style is ``plt.style.use("rodlib.paper.style")``."""

from base64 import b64encode
from dataclasses import dataclass
from pathlib import Path

import matplotlib.pyplot as plt
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from ilctools.files import folder, replacing
from rodlib.paper.comparison import PIXELS_PER_INCH, same_figure
from rodlib.paper.repository import ROOT, results

WIDE = (7.2, 3.2)  # inches, one row of axes
TALL = (7.2, 5.0)  # inches, two rows of axes

# As in the paper: black for the first, gray for the second of a pair, dashed for variants.
BLACK = {"color": "black"}
GRAY = {"color": "0.55"}
BLACK_DASHED = BLACK | {"linestyle": "--"}
GRAY_DASHED = GRAY | {"linestyle": "--"}
# colours of channels: vermilion, blue, green and orange are from the palette of Okabe and Ito
# (2008), which the colour-blind can distinguish
SHADES = ("black", "0.55", "#D55E00", "#0072B2", "#009E73", "#E69F00")
ACCENT = {"color": SHADES[2]}  # for what the paper does not show
MARK = BLACK | {"linestyle": ":", "linewidth": 1}  # bounds, cut-offs, ends of a band, events
# looks of designs, the same in all notebooks; (39) is drawn as in the paper's Figs. 6 and 11
LOOKS = {
    "(39), diagonal": BLACK,
    "(39), non-diagonal": GRAY_DASHED,
    "(45), least gain": {"color": SHADES[3]},
    "(45), least sum": ACCENT | {"linestyle": "-."},
    "(45) with (46)": {"color": SHADES[3], "linestyle": "--"},
    "no ILC": GRAY,
}


@dataclass(frozen=True)
class SavedFigure:
    """A figure in a file. A notebook shows the file itself, which is also what is published."""

    path: Path  # of the PNG file
    width: int  # on the screen, in pixels; the file has more pixels, for print
    caption: str

    def __repr__(self) -> str:
        return f"figures/{self.path.name}"

    def _ipython_display_(self):
        from IPython.display import Markdown, display  # only a notebook has it

        picture = b64encode(self.path.read_bytes()).decode()
        display(
            {"image/png": picture, "text/plain": repr(self)},
            raw=True,
            metadata={"image/png": {"width": self.width, "alt": self.caption}},
        )
        display(Markdown(f"*{self.caption}*"))


def save(figure: Figure, name: str, caption: str) -> SavedFigure:
    """Write a figure to build/figures, or to the folder of the run, as PNG and PDF, and close it.

    The files have the same bytes in every run. The PDF is written only if the PNG differs from the
    one in figures/, or if the PDF there is damaged, because writing a PDF takes as long as
    everything else. As the last expression of a cell, the returned object shows the figure. The
    name begins with the paper's figure, as in "fig04-frequency-response". The caption says what the
    figure shows, in one or two sentences of plain text that can be read alone.
    """
    width = round(figure.get_figwidth() * figure.get_dpi())
    figure.set_dpi(PIXELS_PER_INCH)
    if layout := figure.get_layout_engine():
        layout.execute(figure)
    figure.set_layout_engine("none")  # else the layout is computed at each drawing
    picture = folder(results("figures.save") / "figures") / f"{name}.png"
    with replacing(picture) as temporary:  # without the entries that differ each time
        FigureCanvasAgg(figure).print_png(temporary, metadata={"Software": None})
    if not same_figure(picture, ROOT / "figures" / picture.name):
        with replacing(picture.with_suffix(".pdf")) as temporary:
            figure.savefig(temporary, format="pdf", metadata={"CreationDate": None})
    plt.close(figure)  # or the notebook would draw the figure once more
    return SavedFigure(picture, width, caption)
