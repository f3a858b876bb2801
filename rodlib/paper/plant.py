"""The rod on the workbench."""

from ilctools import arguments
from rodlib.case import assumed_disturbance, assumed_reference, paper_choices, paper_loop
from rodlib.rod import Rod
from rodlib.workbench.plant import Plant


def plant_of_rod(rod: Rod) -> Plant:
    """The paper's loop around a rod, its choices, the assumed reference and disturbances."""
    arguments.instance("rod", rod, Rod)
    source = "" if rod == Rod() else f"rodlib.{rod}"
    return Plant(
        f"rodlib.paper_loop({source})",
        paper_loop(rod),
        reference=assumed_reference(),
        disturbance=assumed_disturbance(),
        choices=paper_choices(),
    )
