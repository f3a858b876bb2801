"""The rod on the workbench."""

from dataclasses import fields

from rodlib.case import (
    assumed_disturbance,
    assumed_reference,
    paper_choices,
    paper_loop,
)
from rodlib.ilc import arguments
from rodlib.ilc.workbench.plant import Plant
from rodlib.rod import Rod


def plant_of_rod(rod: Rod) -> Plant:
    """The paper's loop around a rod, its choices, the assumed reference and disturbances."""
    arguments.instance("rod", rod, Rod)
    changes = [
        f"{field.name}={getattr(rod, field.name)!r}"
        for field in fields(Rod)
        if getattr(rod, field.name) != field.default
    ]
    source = f"rodlib.Rod({', '.join(changes)})" if changes else ""
    return Plant(
        f"rodlib.paper_loop({source})",
        paper_loop(rod),
        reference=assumed_reference(),
        disturbance=assumed_disturbance(),
        choices=paper_choices(),
    )
