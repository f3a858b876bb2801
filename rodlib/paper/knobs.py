"""The rod on the workbench, with its parameters as knobs."""

from dataclasses import fields

from rodlib.case import assumed_disturbance, assumed_reference, paper_loop
from rodlib.ilc import arguments
from rodlib.ilc.workbench.plants import REST, Family, Plant
from rodlib.rod import Rod

UNITS = {
    "length": "m", "width": "m", "height": "m", "density": "kg/m³",
    "heat_capacity": "J/(kg K)", "heat_transfer": "W/(m² K)", "conductivity": "W/(m K)",
}  # fmt: skip


def plant_of_rod(rod: Rod) -> Plant:
    """The paper's loop around a rod, with the assumed reference and disturbances of Section IV."""
    arguments.instance("rod", rod, Rod)
    changed = [f.name for f in fields(Rod) if getattr(rod, f.name) != f.default]
    given = ", ".join(f"{name}={getattr(rod, name)!r}" for name in changed)
    source = (
        f"rodlib.paper_loop(rodlib.Rod({given}))" if given else "rodlib.paper_loop()"
    )
    return Plant(
        source, paper_loop(rod), assumed_reference(), assumed_disturbance(), rest=REST
    )


def rods() -> Family:
    """Rods of any size and material."""
    parameters = {
        f.name: (f.default, UNITS[f.name]) for f in fields(Rod) if f.name in UNITS
    }
    return Family(lambda **values: plant_of_rod(Rod(**values)), parameters)
