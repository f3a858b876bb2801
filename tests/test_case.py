import numpy as np

from rodlib import Rod, paper_loop


def test_paper_loop_takes_another_rod_degree_and_period():
    loop = paper_loop(Rod(conductivity=100.0), degree=2, Ts=2.0)
    assert (loop.Ts, loop.plant.nstates, loop.closed.nstates) == (2.0, 7, 16)
    assert loop.plant.input_labels == ["Q1", "Q3", "theta_a", "Q2", "Q4"]
    assert paper_loop(Ts=np.int64(2)).Ts == 2
    assert [paper_loop(Ts=Ts).Ts for Ts in (1.05e-5, 9.9e3)] == [1.05e-5, 9.9e3]
