"""The parameters of a notebook: what they may be, and whether they are those of the text.

A notebook takes other parameters, by papermill or by hand. Below the cell that has them stands one
call, which refuses in one sentence what no cell could use, and says of a choice that is not the
text's own that the text was written for another one.
"""

import numpy as np

from rodlib.ilc.arguments import number, whole


def checked(**parameters: tuple) -> dict:
    """The values of parameters, by name, each in its range, or a ValueError that names it.

    For a number (value, default, least, most), both ends included, and a whole number if these are
    whole; for all else (value, default), which is only compared.
    """
    for name, (value, _, *ends) in parameters.items():
        if ends and isinstance(ends[0], int | np.integer):
            whole(name, value, *map(int, ends))
        elif ends:
            least, most = ends
            number(
                name,
                value,
                f"a number from {least:g} to {most:g}",
                least=least,
                most=most,
            )
    other = {name: given for name, given in parameters.items() if given[0] != given[1]}
    if other:
        from IPython.display import (
            Markdown,
            display,
        )  # here, since only notebooks have it loaded

        words = ", ".join(f"`{name} = {given[0]!r}`" for name, given in other.items())
        texts = ", ".join(f"`{given[1]!r}`" for given in other.values())
        display(
            Markdown(
                f"**{words}; the text was written for {texts}.** What it says of numbers, and "
                "concludes from them, holds for these only; the cells compute anew."
            )
        )
    return {name: value for name, (value, *_) in parameters.items()}
