"""The workbench: turn a knob of the design and see what it does, in JupyterLab.

From a plant and settings to a filter, its picture and the Python that makes it, without a widget;
:mod:`rodlib.workbench.panel` puts the widgets in front:

    plant → settings → outcome → picture → panel
"""

import os

from ilctools import arguments
from rodlib.workbench.plant import Plant


def open_workbench(plant: Plant, live: bool | None = None):
    """Show the workbench below a cell of a notebook.

    Parameters
    ----------
    plant : Plant
        What filters are designed for, with the task of the trials.
    live : bool, optional
        Whether to show widgets. Default: only if a notebook server has started this kernel for a
        notebook, which sets the variable JPY_SESSION_NAME. nbconvert, papermill and nbval do not.

    Returns
    -------
    Panel or None
        With `settings` and `outcome`, what it shows at the moment; None if it is not live.

    See Also
    --------
    try_out : one setting, without widgets

    Examples
    --------
    >>> from rodlib import open_workbench, paper_loop
    >>> from rodlib.workbench.plant import Plant
    >>> plant = Plant("rodlib.paper_loop()", paper_loop())
    >>> print(open_workbench(plant, live=False))  # in JupyterLab: a Panel
    None
    """
    arguments.instance("plant", plant, Plant)
    if live is None:
        live = "JPY_SESSION_NAME" in os.environ
    if not arguments.flag("live", live):
        return None
    # Here, because these two come with the extra "notebooks".
    from IPython.display import display

    from rodlib.workbench.panel import Panel

    panel = Panel(plant)
    display(panel.widget)
    return panel
