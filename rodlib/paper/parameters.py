"""Check the parameters of a notebook, and whether the text was written for these values.

A user can change the parameters of a notebook, by papermill or by hand. Below the cell with the
parameters, the notebook calls :func:`checked`. The call refuses values that no cell could use, with
a message of one sentence. If a value is not the default, the call displays that the text was
written for another value.
"""

from ilctools.arguments import number, whole


def checked(**parameters: tuple) -> dict:
    """Return the values of parameters by name.

    If a value is outside its range, a ValueError names the parameter.

    A number is passed as (value, default, least, most), with both ends included. If both ends are
    whole numbers, the value must also be a whole number. Any other parameter is passed as (value,
    default), and is only compared with its default.
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
                f"**{choices}, but the text was written for {defaults}.** The numbers and the "
                "conclusions in the text hold for these values only. The cells compute new ones."
            )
        )
    return {name: value for name, (value, *_) in parameters.items()}
