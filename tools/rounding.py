"""Another machine's rounding, acted out on this one: what depends on last digits comes to light.

Two processors differ in the last digits of linear algebra. Here each floating-point result of
numpy.linalg, scipy.linalg, the Fourier transforms, and products of matrices in both packages is
multiplied by 1 + a few units in the last place: Monte Carlo arithmetic, by a seed. What does not
depend on rounding remains: the same operands give the same result, numbers of the same digits in
one result are changed alike (conjugate pairs, symmetric matrices, other units by a power of two),
and a number of few digits, or with those of an operand, is exact.

`pytest --rounding SEED` runs tests so, with the processes that they start; `make machines` all.
"""

import ast
import functools
import importlib.machinery
import os
import sys
import zlib
from pathlib import Path

import numpy as np

ULPS = 4  # at most, as far as the libraries of two processors were seen apart in one operation
FEW = 26  # bits: a number that leaves half of its digits unused was not rounded
SMALL = 2**16  # comparisons up to which the numbers of an operand are looked for in the result
UNROUNDED = {  # functions that arrange numbers, and do not calculate
    "block_diag", "circulant", "companion", "diagonal", "fftfreq", "fftshift", "hankel",
    "ifftshift", "matrix_transpose", "rfftfreq", "toeplitz", "tril", "triu",
}  # fmt: skip
PACKAGES = ("rodlib", "ilctools")
PRODUCTS = ("dot", "einsum", "inner", "tensordot", "vdot")


def search_path(folder: Path, seed: int, path: str = "") -> str:
    """The PYTHONPATH, before `path`, with which processes vary their rounding from the start."""
    folder.mkdir(parents=True, exist_ok=True)
    begin = f"import rounding\nrounding.vary({seed})\n"
    (folder / "sitecustomize.py").write_text(begin, encoding="utf-8")
    return os.pathsep.join(filter(None, [str(folder), str(Path(__file__).parent), path]))


def ipython_folder(folder: Path, seed: int) -> str:
    """The IPYTHONDIR with which products in cells of notebooks are varied, too."""
    startup = folder / "ipython" / "profile_default" / "startup"
    startup.mkdir(parents=True)
    (startup / "rounding.py").write_text(f"import rounding\nrounding.vary_cells({seed})\n")
    return str(folder / "ipython")


def vary_cells(seed: int) -> None:
    """Vary the products `@` in the cells of this kernel."""
    from IPython import get_ipython

    shell = get_ipython()
    shell.ast_transformers.append(_Products())
    shell.user_ns_hidden["__product__"] = shell.user_ns["__product__"] = _product(seed)


def vary(seed: int) -> None:
    """Vary the rounding of this process from now on, once; before anything else is imported."""
    import scipy.fft
    import scipy.linalg

    if any(isinstance(finder, _Finder) for finder in sys.meta_path):
        return
    for room in (np.linalg, scipy.linalg, np.fft, scipy.fft):
        names = [name for name in room.__all__ if name not in UNROUNDED]
        _replace(room, names, seed)
    _replace(np, PRODUCTS, seed)
    sys.meta_path.insert(0, _Finder(_product(seed)))


def _product(seed):
    return _varied(lambda one, other: one @ other, "product", seed)


def _replace(room, names, seed):
    for name in names:
        function = getattr(room, name)
        if callable(function) and not isinstance(function, type):
            setattr(room, name, _varied(function, name, seed))


def _varied(function, name, seed):
    """The function, with results that are moved in their last places."""

    @functools.wraps(function)
    def varied(*operands, **named):
        result = function(*operands, **named)
        if name == "einsum" and len(operands) == 2:  # one operand: a view that may be written to
            return result
        shapes = [getattr(operand, "shape", ()) for operand in operands]
        return move(result, zlib.crc32(f"{seed} {name} {shapes}".encode()), operands)

    return varied


def move(result, key: int, operands=()):
    """A result, or those of a tuple, times 1 + a few units in the last place."""
    if isinstance(result, tuple):
        parts = [move(part, key, operands) for part in result]
        return type(result)(*parts) if hasattr(result, "_fields") else tuple(parts)
    if type(result) is not np.ndarray and not isinstance(result, np.inexact):
        return result
    if result.dtype.char not in "dD":
        return result
    moved = np.array(result, order="C")
    parts = moved.reshape(-1).view(float)  # real and imaginary parts by themselves
    digits = parts.view(np.uint64) & np.uint64(2**52 - 1)
    units = (_mix(digits ^ np.uint64(key)) % np.uint64(2 * ULPS + 1)).astype(float) - ULPS
    units[digits % np.uint64(2**FEW) == 0] = 0
    for operand in operands:  # times one, plus nothing
        if isinstance(operand, np.ndarray) and operand.dtype.char in "dD":
            own = np.ravel(operand).view(float).view(np.uint64) & np.uint64(2**52 - 1)
            if own.size * digits.size <= SMALL:
                units[(digits == own[:, None]).any(axis=0)] = 0
    parts *= 1 + units * np.finfo(float).eps
    return moved if isinstance(result, np.ndarray) else moved[()]


def _mix(bits):
    """Each bit of the outcome depends on all (the finaliser of SplitMix64)."""
    bits = (bits ^ (bits >> np.uint64(30))) * np.uint64(0xBF58476D1CE4E5B9)
    bits = (bits ^ (bits >> np.uint64(27))) * np.uint64(0x94D049BB133111EB)
    return bits ^ (bits >> np.uint64(31))


class _Finder:
    """Finds the modules of both packages, whose `@` is then the varied product."""

    def __init__(self, product):
        self.product = product

    def find_spec(self, name, path=None, target=None):
        if name.split(".")[0] not in PACKAGES:
            return None
        spec = importlib.machinery.PathFinder.find_spec(name, path, target)
        if spec and spec.origin and spec.origin.endswith(".py"):
            spec.loader = _Loader(name, spec.origin)
            spec.loader.product = self.product
        return spec


class _Loader(importlib.machinery.SourceFileLoader):
    """Compiles with `@` replaced, and neither reads nor leaves a cached module."""

    def get_code(self, fullname):
        tree = _Products().visit(ast.parse(self.get_data(self.path), self.path))
        return compile(ast.fix_missing_locations(tree), self.path, "exec")

    def exec_module(self, module):
        module.__dict__["__product__"] = self.product
        super().exec_module(module)


class _Products(ast.NodeTransformer):
    def visit_BinOp(self, node):
        self.generic_visit(node)
        if not isinstance(node.op, ast.MatMult):
            return node
        call = ast.Call(ast.Name("__product__", ast.Load()), [node.left, node.right], [])
        return ast.copy_location(call, node)
