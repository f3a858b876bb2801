"""The parameters of a notebook: what they may be, and whether they are those of the text.

A notebook takes other parameters, by papermill or by hand. Below the cell that has them stands one
call, which refuses in one sentence what no cell could use, and says of a choice that is not the
text's own that the text was written for another one.
"""

from ilctools.arguments import number, whole


def checked(**parameters: tuple) -> dict:
    """The values of parameters, by name, each in its range, or a ValueError that names it.

    For a number (value, default, least, most), both ends included, and a whole number if these are
    whole; for all else (value, default), which is only compared.
    """
    for name, (value, _, *ends) in parameters.items():
        if ends and all(isinstance(end, int) for end in ends):
            whole(name, value, *ends)
        elif ends:
            least, most = ends
            number(name, value, f"a number from {least:g} to {most:g}", least=least, most=most)
    others = [name for name, (value, default, *_) in parameters.items() if value != default]
    if others:
        from IPython.display import Markdown, display  # only a notebook has it

        choices = ", ".join(f"`{name} = {parameters[name][0]!r}`" for name in others)
        defaults = ", ".join(f"`{parameters[name][1]!r}`" for name in others)
        display(
            Markdown(
                f"**{choices}; the text was written for {defaults}.** What it says of numbers, and "
                "concludes from them, holds for these only; the cells compute anew."
            )
        )
    return {name: value for name, (value, *_) in parameters.items()}
