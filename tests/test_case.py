import numpy as np

from rodlib import Rod, paper_loop
from rodlib.case import assumed_disturbance, assumed_reference


def test_paper_loop_takes_another_rod_degree_and_period():
    loop = paper_loop(Rod(conductivity=100.0), degree=2, Ts=2.0)
    assert (loop.Ts, loop.plant.nstates, loop.closed.nstates) == (2.0, 7, 16)
    assert loop.plant.input_labels == ["Q1", "Q3", "theta_a", "Q2", "Q4"]
    assert paper_loop(Ts=np.int64(2)).Ts == 2
    assert [paper_loop(Ts=Ts).Ts for Ts in (1.05e-5, 9.9e3)] == [1.05e-5, 9.9e3]


def test_assumed_signals_are_what_the_text_says_of_the_papers():
    reference, disturbance = assumed_reference(), assumed_disturbance()
    assert reference.shape == (2500, 2) and disturbance.shape == (10, 2500, 3)
    assert not reference[0].any() and not disturbance[:4].any()
    assert not disturbance[:, :, 0].any()
    assert disturbance[4:, :, 1:].any(axis=(1, 2)).all()
    assert np.abs(np.diff(reference, 3, axis=0)).max() < 1e-4  # smooth
    assert np.abs(reference).max() <= 10 + 1e-9
    assert assumed_disturbance(5, 2, 1)[0].any()
    assert assumed_reference(1).shape == (1, 2)
