"""How many bounds on several plants are needed; that they suffice: test_formulate."""

from plants import random_response
from problems import posed

from ilctools.synthesis.cuts import solve


def test_a_handful_of_cuts_is_enough():
    P, Q, omega = random_response(3, 2, 12)
    plants, choices = [P, 0.7 * P, 1.3 * P], {"order": 3, "L_max": 8.0}
    least = solve(posed(plants, Q, omega, 1.0, **choices, objective="peak")).largest
    cuts = solve(posed(plants, Q, omega, 1.0, **choices, M_max=1.02 * least)).cuts
    assert 0 < len(cuts.plant) < len(omega)  # of twice as many
