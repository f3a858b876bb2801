"""Whether parties fit together: one function refuses what does not."""

import control
import pytest

from ilctools import LearningFilter, zero_phase_butterworth
from ilctools.signals import Signals, check_match

MODEL = control.ss(0.5, 1, 1, 0, 0.3)


def test_periods_of_models_filters_and_signals_are_equal_up_to_rounding():
    Q = zero_phase_butterworth(2, 0.1, 0.1 * 3)
    check_match(P=MODEL, Q=Q, L=LearningFilter([[[1.0]]], 0.3), log=Signals())
    with pytest.raises(ValueError, match=r"P.Ts = 0.3, Q.Ts = 0.3000000003"):
        check_match(P=MODEL, Q=zero_phase_butterworth(2, 0.1, 0.3000000003))


def test_labels_of_models_may_differ_but_not_in_their_order():
    one, other, turned = (Signals(labels=names) for names in (["a", "b"], ["a", "c"], ["b", "a"]))
    check_match(P=one, plant=other, model=MODEL)
    for last in (turned, Signals(labels=["b", "c"])):
        with pytest.raises(ValueError, match=r"plant\.labels"):
            check_match(nothing=MODEL, P=one, plant=last)


def test_one_plant_among_a_thousand_that_differs_is_found_wherever_it_stands():
    names = {f"P[{k}]": Signals(0.1 * 3, labels=["a", "b"]) for k in range(1000)}
    check_match(**names)
    for odd, words in [
        (Signals(0.3, labels=["b", "a"]), r"P\[640\]\.labels = \['b', 'a'\]"),
        (Signals(0.3000000003), r"P\[640\]\.Ts = 0\.3000000003,"),
    ]:
        with pytest.raises(ValueError, match=words):
            check_match(**names | {"P[640]": odd})
    check_match(**names | {"P[640]": Signals(0.3, labels=["a", "c"])})


@pytest.mark.parametrize(
    ("other", "words"),
    [
        (Signals(outputs=["b", "a"]), "log.outputs"),
        (Signals(outputs=["a"]), "log.channels = 1"),
        (Signals(controls=["u"]), "log.controls"),
        (Signals(units={"b": "K", "a": "m"}), "loop has a in 'mm', but log in 'm'"),
    ],
)
def test_channels_their_order_and_units_must_match(other, words):
    units = {"a": "mm", "b": ""}
    loop = Signals(1.0, ["a", "b"], ["u", "w"], units)
    check_match(loop=loop, log=Signals(units={"b": "K"}), law=Signals(1.0))
    with pytest.raises(ValueError, match=words):
        check_match(loop=loop, log=other)
