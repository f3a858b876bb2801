"""Whether parties fit together: one function refuses what does not."""

import control
import pytest

from ilctools import LearningFilter, zero_phase_butterworth
from ilctools.signals import Signals, check_match

MODEL = control.ss(0.5, 1, 1, 0, 0.3)


def test_periods_of_models_filters_and_signals_are_equal_up_to_rounding():
    Q = zero_phase_butterworth(2, 0.1, 0.1 * 3)
    check_match(P=MODEL, Q=Q, L=LearningFilter([[[1.0]]], 0.3), log=Signals())
    with pytest.raises(ValueError, match=r"P.Ts = 0.3, but Q.Ts = 0.3000000003"):
        check_match(P=MODEL, Q=zero_phase_butterworth(2, 0.1, 0.3000000003))


def test_labels_of_models_may_differ_but_not_in_their_order():
    one, other, turned = (Signals(labels=names) for names in (["a", "b"], ["a", "c"], ["b", "a"]))
    check_match(P=one, plant=other, model=MODEL)
    for last in (turned, Signals(labels=["b", "c"])):
        with pytest.raises(ValueError, match=r"plant\.labels"):
            check_match(nothing=MODEL, P=one, plant=last)


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (Signals(outputs=["b", "a"]), "log.outputs"),
        (Signals(outputs=["a"]), "loop has 2 outputs, but log has 1 outputs"),
        (Signals(controls=["u"]), "log.controls"),
        (Signals(units={"b": "K", "a": "m"}), r"units\['a'\] = 'mm', but log.units\['a'\] = 'm'"),
    ],
)
def test_channels_their_order_and_units_must_match(other, words):
    units = {"a": "mm", "b": ""}
    loop = Signals(1.0, ["a", "b"], ["u", "w"], units)
    check_match(loop=loop, log=Signals(units={"b": "K"}), law=Signals(1.0))
    with pytest.raises(ValueError, match=words):
        check_match(loop=loop, log=other)
