"""Write the stubs of both packages from their registries: what an editor completes is there.

A name is imported when it is first used, which no type checker follows. `make stubs`
writes, beside each package's __init__.py, where its names are at home; tests/test_stubs.py holds
them against the registry.
"""

from pathlib import Path

import ilctools
import rodlib

BEGIN = "# From the registry in __init__.py, by `make stubs`.\n\n"


def stub(package, modules: dict[str, str], rooms=()) -> str:
    """The stub of a package: an import of each name from its home, in ruff's order."""
    homes = {f".{module}": names.split() for module, names in modules.items()}
    imports = [("", room) for room in rooms]
    imports += [(home, name) for home, names in homes.items() for name in names]
    imports = sorted((package + home, _rank(name), name) for home, name in imports)
    lines = [f"from {home} import {name} as {name}\n" for home, _, name in imports]
    return BEGIN + "".join(lines)


def _rank(name):
    """Constants, then classes, then functions."""
    return 0 if name.isupper() else 1 if name[0].isupper() else 2


def stubs() -> dict[Path, str]:
    """Each stub by its path."""
    of_rodlib = stub("rodlib", rodlib.MODULES)
    of_ilc = stub("ilctools", ilctools.MODULES, ilctools.ROOMS)
    return {
        Path(package.__file__).with_suffix(".pyi"): text + "\n__version__: str\n"
        for package, text in ((rodlib, of_rodlib), (ilctools, of_ilc))
    }


if __name__ == "__main__":
    for path, text in stubs().items():
        path.write_text(text, encoding="utf-8")
