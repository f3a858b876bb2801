"""The workbench: turn a knob of the design and see what it does, in JupyterLab.

From a plant and the knobs to a filter, its picture and the Python that makes it, without a widget;
:mod:`rodlib.ilc.workbench.panel` puts the widgets in front:

    plants → settings → outcome → picture → panel
"""

import os

from rodlib.ilc import arguments, lazily
from rodlib.ilc.workbench.plants import Family, Plant

MODULES = {
    "outcome": "Outcome try_out",
    "picture": "Picture",
    "plants": "Family Plant plant_of_file",
    "settings": "Settings",
}
__getattr__, __dir__, __all__ = lazily(__name__, MODULES)
__all__ += ["workbench"]


def workbench(
    plants: dict[str, Plant | Family] | None = None,
    log: str = "",
    live: bool | None = None,
):
    """Show the workbench below the cell, where there is somebody to use it.

    Parameters
    ----------
    plants : dict of Plant or Family, optional
        Plants by the names under which they can be chosen, beside logs; the first is shown first.
    log : str
        Path of the log that is offered.
    live : bool, optional
        Whether to show widgets. Default: if a notebook server has started this kernel for a
        notebook, which it says by the variable JPY_SESSION_NAME. nbconvert, papermill and nbval
        start kernels of their own, without it: what they write then holds no widgets.

    Returns
    -------
    Panel or None
        With ``settings`` and ``outcome``, what it shows at the moment; None if it is not live.
    """
    plants = arguments.instance("plants", {} if plants is None else plants, dict)
    for name, plant in plants.items():
        if not isinstance(plant, Family):
            arguments.instance(f"plants[{name!r}]", plant, Plant)
    arguments.instance("log", log, str)
    if live is None:
        live = "JPY_SESSION_NAME" in os.environ
    if not arguments.flag("live", live):
        return None
    from IPython.display import (
        display,
    )  # here, because these two come with the extra "notebooks"

    from rodlib.ilc.workbench.panel import Panel

    panel = Panel(plants, log)
    display(panel.widget)
    return panel
