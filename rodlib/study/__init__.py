"""Many plants: rods as they may be, sampled, judged and simulated in batches, on dask, resumable.

A :class:`Study` says how far off the rods may be and what is to be found out about each of them;
:func:`run` finds it out for the first so many.

- :mod:`rodlib.specimens`: the rods, and the loop around each of them;
- :mod:`rodlib.study.course`: the trials of many rods at once;
- :mod:`rodlib.study.batches`: work in batches on dask, each finished one a file;
- :mod:`rodlib.study.study`: the question and its answer.
"""

from rodlib.study.batches import local_cluster
from rodlib.study.study import Study, run

__all__ = ["Study", "local_cluster", "run"]
