"""Long work in batches, on dask: what is finished is a file, and is not computed again.

This knows nothing of rods. The batches do not depend on who computes them, so any number of
workers gives the same files, to the byte.
"""

import io
import logging
import os
from collections.abc import Callable
from contextlib import closing, contextmanager
from pathlib import Path

import numpy as np
from tqdm import tqdm

from rodlib.ilc import arguments
from rodlib.ilc.files import alone, folder, replacing

PROCESS = {  # environment of the workers, beside what dask sets
    "OMP_NUM_THREADS": 1,  # or the number of cores would decide on the last digits
    "OPENBLAS_NUM_THREADS": 1,
    # Memory that is fetched from the system anew for every array costs as much as the arithmetic.
    "MALLOC_TRIM_THRESHOLD_": 2**30,
    "MALLOC_MMAP_THRESHOLD_": 2**25,
}


def complete(
    work: Callable[[int, int], dict[str, np.ndarray]],
    name: str,
    count: int,
    size: int,
    where: Path,
    *,
    scheduler: str | None = None,
    workers: int | None = None,
) -> dict[str, np.ndarray]:
    """Do some work for the numbers 0 ... count - 1, as far as it has not been done before.

    Parameters
    ----------
    work : callable
        ``work(start, stop)`` gives arrays, by name, whose first axis are the numbers from start
        up to stop. It is sent to the workers, so that it must be possible to pickle it.
    name : str
        Of this work, different from that of any other: the files are named after it.
    count, size : int
        How many numbers there are, and how many of them make a batch.
    where : Path
        Folder of the files, one for each finished batch, written as a whole or not at all. One
        that is damaged, or is another's, is written anew.
    scheduler : str, optional
        Address of a dask scheduler, such as ``"tcp://host:8786"``, whose workers have this very
        rodlib. Default: a cluster on this computer, for the time of the call.
    workers : int, optional
        Number of processes of that cluster. Default: one for each core. 0 does the work in this
        process, which takes less than a cluster takes to start if the work is short; how many
        threads its linear algebra has may then decide on last digits.

    Returns
    -------
    dict of ndarray
        The arrays of all batches, one after the other.

    Raises
    ------
    RuntimeError
        If another process is at it in the same folder.
    OSError
        If there is no scheduler at that address.
    """
    parts = [(start, min(start + size, count)) for start in range(0, count, size)]
    paths = [folder(where) / f"{name}-{start:06}-{stop:06}.npz" for start, stop in parts]
    with alone(where / "lock", f"another process is at work in {where}: wait for it, or stop it"):
        found = {part: _load(path) for part, path in zip(parts, paths, strict=True)}
        missing = {part: path for part, path in zip(parts, paths, strict=True) if not found[part]}
        if missing:
            here = workers == 0 and scheduler is None
            done = _in_turn(work, missing) if here else _on_dask(work, missing, scheduler, workers)
            with (
                closing(done),
                tqdm(total=len(parts), initial=len(parts) - len(missing), disable=None) as bar,
            ):
                for part, arrays in done:
                    found[part] = arrays
                    _save(missing[part], arrays)
                    bar.update()
    return {key: np.concatenate([found[part][key] for part in parts]) for key in found[parts[0]]}


def _in_turn(work, parts):
    for part in parts:
        yield part, work(*part)


def _on_dask(work, parts, scheduler, workers):
    from distributed import as_completed

    with _client(scheduler, workers, len(parts)) as client:
        futures = {client.submit(work, *part, pure=False): part for part in parts}
        for future in as_completed(futures):
            yield futures[future], future.result()


@contextmanager
def local_cluster(workers: int | None = None):
    """A dask cluster on this computer, for several runs: its ``scheduler_address`` names it.

    Parameters
    ----------
    workers : int, optional
        Number of processes. Default: one for each core.
    """
    if workers is not None:
        arguments.whole("workers", workers, 1)
    # Not imported before it is needed: that takes a second.
    import dask
    from dask.system import CPU_COUNT
    from distributed import LocalCluster

    settings = {f"distributed.nanny.pre-spawn-environ.{name}": x for name, x in PROCESS.items()}
    with (
        dask.config.set(settings),
        LocalCluster(
            n_workers=workers or CPU_COUNT,
            threads_per_worker=1,
            dashboard_address=":0",  # any free port: another cluster may be running
            silence_logs=logging.CRITICAL,
        ) as cluster,
    ):
        cluster.loop.asyncio_loop.set_exception_handler(_unless_late)
        yield cluster


def _unless_late(loop, context):
    """Say what went wrong in dask, but for timers that run out when nobody waits any more."""
    from tornado.util import TimeoutError as Late

    if not isinstance(context.get("exception"), Late):
        loop.default_exception_handler(context)


@contextmanager
def _client(scheduler, workers, most):
    from dask.system import CPU_COUNT
    from distributed import Client

    if scheduler is not None:
        with Client(scheduler) as client:
            client.loop.asyncio_loop.set_exception_handler(_unless_late)
            yield client
        return
    with local_cluster(min(workers or CPU_COUNT, most)) as cluster, Client(cluster) as client:
        yield client


def _save(path, arrays):
    with replacing(path) as temporary, open(temporary, "wb") as file:
        np.savez(file, batch=path.stem, **arrays)
        file.flush()
        os.fsync(file.fileno())


def _load(path):
    """The arrays of a batch, or None if this is not its file, as it was written."""
    try:
        with np.load(io.BytesIO(path.read_bytes()), allow_pickle=False) as file:
            arrays = dict(file)  # the format keeps a sum of every array, which is checked
        return arrays if arrays.pop("batch") == path.stem else None
    except Exception:  # there is no end to what a damaged file may raise
        return None
