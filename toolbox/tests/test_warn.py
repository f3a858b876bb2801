"""A warning stands at the line that called the toolbox; rigs and studies hold that for theirs."""

import warnings

from ilctools.warn import warn


def test_a_call_from_outside_is_named():
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warn("look here")
    assert (caught[0].filename, str(caught[0].message)) == (__file__, "look here")
