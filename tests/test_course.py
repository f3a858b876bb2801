import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from plants import modal_model

from rodlib import LearningFilter, Spread, draw, paper_loop, run_trials, zero_phase_butterworth
from rodlib.case import assumed_disturbance, assumed_reference
from rodlib.course import Course
from rodlib.ilc.trials import rms
from rodlib.paper import published

ALL = Spread.of_all(0.3)
SLOW = paper_loop(Ts=10.0)


def simulated(loop, Q, L, specimen, modes, *arguments, **keywords):
    plant = modal_model(specimen, loop.Ts, modes)
    return rms(run_trials(loop, Q, L, *arguments, plant=plant, **keywords).e).values


@pytest.mark.parametrize("rest", [0, 100])
def test_the_papers_trials_are_those_of_run_trials(loop, Q, rest):
    reference, d = assumed_reference(), assumed_disturbance(trials=4, first=3)
    d[:, :, 0] = np.linspace(0, 3, len(reference))  # the air, warm at the end of a trial
    filters = [LearningFilter(published.matrix(f"L_{kind}"), 1.0) for kind in ("diagonal", "full")]
    specimens = [draw(ALL, number) for number in range(2)]
    course = Course(loop, Q, filters, reference, d, 4, rest)
    found = course.rms([each.held(1.0) for each in specimens])
    assert found.shape == (2, 2, 4)
    for f, g in ((0, 0), (1, 1)):
        expected = simulated(
            loop, Q, filters[f], specimens[g], 150, reference, d, trials=4, rest=rest
        )
        np.testing.assert_allclose(found[g, f], expected, rtol=0, atol=1e-9)


@given(
    samples=st.integers(1, 70),
    orders=st.lists(st.integers(1, 12), min_size=1, max_size=2),
    trials=st.integers(1, 4),
    rest=st.integers(0, 69),
    disturbed=st.sampled_from([None, "every", "each"]),
    cutoff=st.floats(0.003, 0.2),
    order=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_any_trials_are_those_of_run_trials(
    samples, orders, trials, rest, disturbed, cutoff, order, seed
):
    rng, rest = np.random.default_rng(seed), min(rest, samples - 1)
    Q = zero_phase_butterworth(order, cutoff, SLOW.Ts)
    filters = [LearningFilter(rng.standard_normal((2, 2, taps)), SLOW.Ts) for taps in orders]
    reference = rng.standard_normal((samples, 2))
    shape = (trials, samples, 3) if disturbed == "each" else (samples, 3)
    d = rng.standard_normal(shape) if disturbed else None
    specimen = draw(ALL, seed % 1000)
    course = Course(SLOW, Q, filters, reference, d, trials, rest)
    found = course.rms([specimen.held(SLOW.Ts)])[0]
    for f, L in enumerate(filters):
        expected = simulated(SLOW, Q, L, specimen, 60, reference, d, trials, rest=rest)
        np.testing.assert_allclose(found[f], expected, rtol=1e-9)


def test_rods_side_by_side_are_what_they_are_alone(loop, Q):
    course = Course(
        loop, Q, [LearningFilter(np.ones((2, 2, 1)), 1.0)], np.ones((200, 2)), None, 3, 0
    )
    rods = [draw(ALL, number).held(1.0) for number in range(5)]
    alone = np.concatenate([course.rms([rod]) for rod in rods])
    np.testing.assert_allclose(course.rms(rods), alone, rtol=1e-12)
