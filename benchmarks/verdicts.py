"""Which verdicts of the ledger hang on what we assume? Each such claim for other signals and rigs.

`make measure WHAT=verdicts` varies what the paper does not print: one thing at a time, and then
all of it together, drawn by seed. The table goes to figures/performance.md: the range of each
number that a claim is judged by, and what turns its verdict. The ledger judges no claim that turns
here: its row says in words what it depends on (tests/paper/test_verdicts.py).
"""

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache
from typing import NamedTuple

import control
import numpy as np
from runner import publish, run, table
from scipy.signal import lfilter
from scipy.sparse import eye_array
from scipy.sparse.linalg import aslinearoperator, gmres

from ilctools import (
    Controller,
    Law,
    convergence,
    least_gain,
    record,
    rms,
    run_trials,
    synthesise,
    trial_map,
    trial_operators,
)
from ilctools.filters import LearningFilter, zero_phase_butterworth
from rodlib import (
    MISMATCHED,
    PeltierParameters,
    PeltierRig,
    RestartingPeltierRig,
    Rod,
    Spread,
    VirtualRig,
    assumed_disturbance,
    assumed_reference,
    draw,
    midr,
    paper_choices,
    paper_loop,
    responses,
)
from rodlib.paper import published
from rodlib.paper.ledger import verdict
from rodlib.paper.rig_logs import DECIMALS
from rodlib.peltier_rig import PeltierElement

# What a claim was judged by until its verdict turned here; now its row is in words.
FORMER = {
    "fast": "< 0.1",
    "disturbance_seen": "> 1",
    "quick_again": "< 0.1",
    "full_little": "> 0.667",
    "u_converges": "< 0.05",
    "e_infinity": "< 0.01",
    "noise_45": "> 1",
    "noise_L_max": "> 1",
    "L_max_noise": "> 1",
    "M_max_robustness": "> 1",
    "exact_model": "< 0.2",
    "repetitive": "< 0.2",
    "ambient": "< 0.01",
    "peltier": "< 0.2",
    "loop_off": "> 0.03",
}
FOLLOWING = 5  # trials after the first disturbed one, as in the paper
DRAWS = {"signals": 40, "noise": 10, "rods": 10, "rigs": 20}  # of all together
LOOP = paper_loop()
Q = zero_phase_butterworth(2, 0.1, 1.0)
STRETCH = 2500  # samples of a trial in the paper


class Assumed(NamedTuple):
    """One choice of all that the paper leaves open; by default, ours."""

    steepness: float = 1.0  # of the moves, relative to ours
    plateaus: tuple = ((10.0, 6.0), (8.0, 10.0))  # K
    samples: int = STRETCH  # of a trial, to which references and disturbances are stretched
    flows: tuple = (5.0, -4.0)  # peaks of the disturbances, W
    duration: float = 0.5  # of a pulse, as a share of the trial
    switched: bool = False  # whether the pulses are rectangles
    first: int = 5  # trial with the disturbance
    seed: int = 1  # of the sensors' noise
    memory: float = 0.0  # of the noise: its correlation decays by 1/e in this time, s
    searched: float = 2100.0  # L_max that a search without regard to noise finds (notebook 8)
    spread: float = 0.2  # of a rod's parameters
    places: float = 1.0  # of the sensors, as a share of what all else is off by
    root: int = 2  # of the rods that are drawn
    linear: bool = False  # whether the rig is the linear one
    number: int = -1  # of a drawn rod in the rig; -1 is ours
    resistance: float = 2.0  # of the elements, ohm
    warming: float = 5e-5  # of the room, K/s
    pause: int = 600  # between two trials, s

    def reference(self):
        """Both references, K, shape (samples, 2)."""
        return assumed_reference(self.samples, self.steepness, self.plateaus)

    def disturbance(self, trials, first):
        """Ambient temperature and heat flows of all trials, shape (trials, samples, 3)."""
        d = assumed_disturbance(self.samples, trials, first, self.flows, self.duration)
        return np.where(d == 0, 0, np.sign(d) * np.abs(d).max((0, 1))) if self.switched else d

    def noise(self, root, shape):
        """Noise of the sensors with a standard deviation of one."""
        white = np.random.default_rng(root).standard_normal(shape)
        if not self.memory:
            return white
        decay = np.exp(-1 / self.memory)
        white[:, 1:] *= np.sqrt(1 - decay**2)
        return lfilter([1], [1, -decay], white, axis=1)


def scaled(output, plateau, factor):
    """The plateaus, one of them scaled."""
    levels = np.array(Assumed().plateaus)
    levels[output, plateau] *= factor
    return tuple(map(tuple, levels.tolist()))


# What is varied, by kind: what is said of it, and how it differs from our choice.
MOVES = {f"moves {s:g} times as steep": {"steepness": s} for s in (0.7, 0.85, 1.25, 1.5, 2.0)}
PLATEAUS = {
    f"plateau {plateau + 1} of output {output + 1} {100 * (f - 1):+.0f} %": {
        "plateaus": scaled(output, plateau, f)
    }
    for output in (0, 1)
    for plateau in (0, 1)
    for f in (0.7, 1.3)
}
LENGTHS = {f"{n} samples": {"samples": n} for n in (1800, 2000, 3200, 4000)}
FLOWS = {
    "half the disturbance": {"flows": (2.5, -2.0)},
    "twice the disturbance": {"flows": (10.0, -8.0)},
    "both heat flows positive": {"flows": (5.0, 4.0)},
    "Q2 only": {"flows": (5.0, 0.0)},
    "Q4 only": {"flows": (0.0, -4.0)},
}
SHAPES = {
    "half as long a pulse": {"duration": 0.25},
    "1.4 times as long a pulse": {"duration": 0.7},
    "a disturbance switched on and off": {"switched": True},
}
BEGINS = {f"disturbed from trial {k} on": {"first": k} for k in (3, 4, 6, 7)}
SEEDS = {f"noise of seed {seed}": {"seed": seed} for seed in (4, 7, 10, 13)}
COLOURS = {f"noise with a memory of {T} s": {"memory": T} for T in (3, 10, 60)}
TRIALS = {f"{n} samples": {"samples": n} for n in (1250, 5000, 10_000)}
SEARCHES = {f"an L_max of {g} by the search": {"searched": g} for g in (200, 600, 6000, 20_000)}
SPREADS = {f"rods off by up to {100 * s:.0f} %": {"spread": s} for s in (0.1, 0.15, 0.25, 0.3)}
PLACES = {"sensors in place": {"places": 0.0}, "sensors off by a quarter": {"places": 0.25}}
ROOTS = {f"rods of draw {root}": {"root": root} for root in (3, 4, 5, 6)}
RIGS = {"a linear rig": {"linear": True}}
RIGS |= {f"a rig with drawn rod {k}": {"number": k} for k in range(4)}
RIGS |= {f"elements of {R:g} ohm": {"resistance": R} for R in (1.0, 3.0)}
ROOMS = {f"the room warms {f:g} times as fast": {"warming": 5e-5 * f} for f in (0.5, 1.5, 2, 4)}
PAUSES = {f"a pause of {s} s": {"pause": s} for s in (300, 1200, 2400)}
SIGNALS = [MOVES, PLATEAUS, LENGTHS, FLOWS, SHAPES, BEGINS]


@cache
def filters():
    """The learning filters that are compared."""
    omega, bounds = np.geomspace(1e-4, np.pi, 1000), paper_choices()
    least = {key: bounds[key] for key in ("order", "M_max", "structure")}
    asked = {
        "diagonal": (omega, {}),
        "full": (omega, {"structure": "full"}),
        "(45) with (46)": (omega, {"objective": "peak"}),
        **{gain: (np.geomspace(1e-4, np.pi, 250), {"L_max": gain}) for gain in (50.0, 400.0)},
    }
    found = {
        name: synthesise(LOOP, Q, at, 1.0, **bounds | changes).filter
        for name, (at, changes) in asked.items()
    }
    found["least gain"] = least_gain(LOOP, Q, omega[::3], 1.0, **least).filter
    for kind in ("diagonal", "full"):
        found[f"printed {kind}"] = LearningFilter(published.matrix(f"L_{kind}"), 1.0)
    return found


def of_trials(a):
    """Ten trials in simulation (notebook 4), with the disturbance from trial `first` on."""
    trials, before = a.first + FOLLOWING, a.first - 2  # the last trial without it, from zero
    reference, d = a.reference(), a.disturbance(trials, a.first)
    size = {
        name: rms(run_trials(LOOP, Law(Q, filters()[name]), reference, d, trials).e).values
        for name in ("diagonal", "full", "(45) with (46)")
    }
    undisturbed = {
        name: rms(run_trials(LOOP, Law(Q, filters()[name]), reference, trials=4).e).values
        for name in size
    }
    steps = size["diagonal"][1:] / size["diagonal"][:-1]
    fourth = {name: values[3] / values[0] for name, values in undisturbed.items()}
    return {
        "fast": fourth["diagonal"],
        "monotone": steps[:before].max(),
        "disturbance_seen": steps[before],
        "monotone_again": steps[before + 1 :].max(),
        "quick_again": steps[before + 1 : before + 4].prod(),
        "slow_4546": fourth["(45) with (46)"],
        "full_little": fourth["full"] / fourth["diagonal"],
        "u_converges": distance_of_u(reference),
    }


def distance_of_u(reference):
    """RMS of the distance of u_10 to u_80, relative to that of u_1."""
    u = run_trials(LOOP, Law(Q, filters()["printed diagonal"]), reference, trials=80).u
    distance = rms(u - u[-1]).values
    return distance[9] / distance[0]


def of_endless_trials(a):
    """Equations (36) and (38) against trials with long rests before and after (notebook 3)."""
    L, rests = filters()["printed diagonal"], [(500, 2000), (0, 0)]
    reference, d = (np.pad(x, rests) for x in (a.reference(), a.disturbance(1, 1)[0]))
    n = len(reference)
    omega = 2 * np.pi * np.fft.rfftfreq(n)
    P, q = LOOP.frequency_response(omega), Q.frequency_response(omega)[:, None, None]
    P_tilde = LOOP.closed(np.exp(1j * omega))[:, 2:].transpose(2, 0, 1)
    Y_ref, D = (np.fft.rfft(x, axis=0)[..., None] for x in (reference, d))
    E_1 = Y_ref - P @ Y_ref - P_tilde @ D
    M = q * (np.eye(2) - P @ L.frequency_response(omega))
    E_inf = np.linalg.solve(np.eye(2) - M, (1 - q) * E_1)
    predicted = {"error_law": (1, M @ E_1 + (1 - q) * E_1), "final_error": (99, E_inf)}
    simulated = run_trials(LOOP, Law(Q, L), reference, d, trials=100).e.values
    return {
        key: np.abs(simulated[k] - np.fft.irfft(E[..., 0], n, axis=0)).max()
        / np.abs(simulated[k]).max()
        for key, (k, E) in predicted.items()
    }


def of_limits(a):
    """Lemma 1 and (38) on trials with two ends (notebook 6)."""
    L, reference, samples = filters()["diagonal"], a.reference(), a.samples
    P_N, Q_N, L_N = trial_operators(LOOP.P, Q, L, samples)
    T = trial_map(LOOP.P, Q, L, samples)
    e_1 = reference.ravel() - P_N @ reference.ravel()
    I_minus_T = aslinearoperator(eye_array(T.shape[0])) - T
    v_inf, _ = gmres(I_minus_T, Q_N @ (L_N @ e_1), rtol=1e-12, restart=200)
    e_inf = (e_1 - P_N @ v_inf).reshape(samples, 2)
    errors = run_trials(LOOP, Law(Q, L), reference, None, 80).e.values
    distance = np.linalg.norm(errors - e_inf, axis=(1, 2))

    length = 8 * samples
    omega = 2 * np.pi * np.fft.rfftfreq(length)
    P, q = LOOP.frequency_response(omega), Q.frequency_response(omega)[:, None, None]
    M = q * (np.eye(2) - P @ L.frequency_response(omega))
    Y_ref = np.fft.rfft(reference, length, axis=0)[..., None]
    E_inf = np.linalg.solve(np.eye(2) - M, (1 - q) * (Y_ref - P @ Y_ref))  # (38) with D = 0
    final = np.fft.irfft(E_inf[..., 0], length, axis=0)[:samples]
    return {
        "lemma_1": (distance[1:] / distance[:-1]).max(),
        "e_infinity": np.linalg.norm(errors[-1] - final) / np.linalg.norm(final),
    }


def from_noise(a, L, rest, since):
    """RMS of what noise does to the rod's own outputs in 60 trials, from one on, in three draws."""
    power = []
    for seed in range(a.seed, a.seed + 3):
        noise = 0.02 * a.noise(seed, (60, a.samples, 2))
        still = np.zeros((a.samples, 2))
        run_ = run_trials(LOOP, Law(Q, L, rest=rest), still, trials=60, noise=noise)
        power.append(np.sqrt((rms(run_.e + noise)[since:] ** 2).mean().item()))
    return np.mean(power)


def learned_noise(a, L):
    """RMS of what learning has made of the noise of earlier trials, -P v of trials 6 to 10."""
    fine = control.sample_system(midr(Rod(), 8), 1.0, "zoh")
    parts = []
    for k in range(5):
        noise = 0.02 * a.noise([a.seed - 1, k], (10, a.samples, 2))
        with_and_without = (
            run_trials(
                LOOP, Law(Q, each, rest=15), 0 * noise[0], trials=10, plant=fine, noise=noise
            )
            for each in (L, None)
        )
        learned, alone = (each.e for each in with_and_without)
        parts.append((rms(learned - alone)[5:] ** 2).mean().item())
    return np.sqrt(np.mean(parts))


@cache
def tuned(gain):
    """The non-diagonal filter of notebook 8 with this bound on its gain."""
    omega = np.union1d(np.geomspace(1e-4, 0.3, 100), np.linspace(0.3, np.pi, 80))
    return synthesise(LOOP, Q, omega, 1.0, **paper_choices(L_max=gain, structure="full")).filter


def of_noise(a):
    """What the gain of L makes of noise (notebooks 6, 8 and 19)."""
    least, diagonal = (from_noise(a, filters()[L], 0, 10) for L in ("least gain", "diagonal"))
    high, low = (from_noise(a, filters()[gain], 15, 30) for gain in (400.0, 50.0))
    larger, printed = (learned_noise(a, L) for L in (tuned(a.searched), filters()["printed full"]))
    return {
        "noise_45": least / diagonal,
        "noise_L_max": high / low,
        "L_max_noise": larger / printed,
    }


def of_rods(a):
    """Drawn rods on which a smaller M_max converges monotonically (notebook 9)."""
    spread = Spread.of_all(a.spread)
    spread = replace(spread, sensors=a.places * spread.sensors)
    critical = np.geomspace(5e-3, 0.5, 50)[:-1]  # where rods are judged: elsewhere sigma(M) < 1
    P = responses(LOOP, [draw(spread, k, root=a.root) for k in range(1000)], critical)
    strict, loose = (
        np.mean(convergence(P, Q, bounded(M_max), critical).gamma < 1) for M_max in (0.85, 0.95)
    )
    return {"M_max_robustness": strict / loose}


@cache
def bounded(M_max):
    """The diagonal filter of notebook 9 with this bound on M."""
    omega = np.union1d(np.geomspace(1e-4, 0.3, 100), np.linspace(0.3, np.pi, 100))
    return synthesise(LOOP, Q, omega, 1.0, **paper_choices(M_max=M_max)).filter


def rig_of(a, kind=PeltierRig, seed=1):
    """A rig with Peltier elements and a proportional map, or a linear one."""
    rod = draw(Spread.of_all(0.1), a.number, root=1).rod if a.number >= 0 else MISMATCHED
    if a.linear:
        return VirtualRig(rod, seed=seed)
    element, known = PeltierElement(resistance=a.resistance), PeltierElement(resistance=0.0)
    parameters = PeltierParameters(element=element, known=known, ambient_rate=a.warming)
    return kind(rod, parameters, seed=seed)


def of_logs(a):
    """The log of the virtual rig, recorded anew (notebooks 5 and 16)."""
    experiment = {
        "loop": LOOP,
        "reference": np.round(a.reference(), 6),
        "disturbance": np.round(a.disturbance(10, 5), 6),
        "decimals": DECIMALS,
        "pause": a.pause,
    }
    learning, alone = (
        rms(record(rig_of(a, seed=seed), law=Law(Q, L, limits={}), **experiment).e).values
        for L, seed in ((filters()["printed diagonal"], a.seed), (None, a.seed + 1))
    )
    drift = alone[4:]
    restarting = rig_of(a, RestartingPeltierRig, a.seed)
    law = Law(Q, filters()["diagonal"], rest=15, limits={})
    again = record(restarting, LOOP, law, a.reference(), trials=4)
    fourth = rms(again.e).values
    return {
        "exact_model": learning[3] / learning[0],
        "repetitive": learning[9] / learning[4],
        "ambient": drift.max() / drift.min() - 1,
        "peltier": fourth[3] / fourth[0],
        "loop_off": initial_error(a),
    }


def initial_error(a):
    """The smallest mean error of trials 2 to 4 over ten samples, with the loop off between them."""
    rig, task, inputs, initial = rig_of(a, seed=a.seed + 2), a.reference(), np.zeros(4), []
    for trial in range(1, 5):
        controller, e = Controller(LOOP, 4), []
        for w in task if trial < 4 else task[:10]:
            y = rig.read()
            inputs[::2] = controller.step(y, w)  # elements 1 and 3
            rig.apply(inputs)
            e.append(w - y)
        initial.append(np.mean(e[:10], axis=0))
        for _ in range(a.pause):
            rig.apply(np.zeros(4))
    return np.abs(initial[1:]).min()


class Group(NamedTuple):
    """Claims that one function computes, and the kinds of assumptions that they hang on."""

    function: Callable[[Assumed], dict[str, float]]
    kinds: list[dict[str, dict]]
    draws: int


GROUPS = [
    Group(of_trials, SIGNALS, DRAWS["signals"]),
    Group(of_endless_trials, [MOVES, PLATEAUS, LENGTHS, FLOWS, SHAPES], DRAWS["signals"]),
    Group(of_limits, [MOVES, PLATEAUS, LENGTHS], DRAWS["signals"]),
    Group(of_noise, [SEEDS, COLOURS, TRIALS, SEARCHES], DRAWS["noise"]),
    Group(of_rods, [SPREADS, PLACES, ROOTS], DRAWS["rods"]),
    Group(
        of_logs,
        [MOVES, PLATEAUS, LENGTHS, FLOWS, SHAPES, SEEDS, RIGS, ROOMS, PAUSES],
        DRAWS["rigs"],
    ),
]


def drawn(kinds, number):
    """Of each kind a variation at random, or ours."""
    rng, changes = np.random.default_rng([0, number]), {}
    for kind in kinds:
        changes |= [{}, *kind.values()][rng.integers(len(kind) + 1)]
    return changes


def variations(group):
    """By what is said of it, how what is assumed differs from our choice; first comes ours."""
    alone = {name: changes for kind in group.kinds for name, changes in kind.items()}
    together = {f"draw {k}": drawn(group.kinds, k) for k in range(group.draws)}
    return {"ours": {}} | alone | together


def computed(function, changes):
    """All numbers of a group of claims for one choice of what is assumed."""
    with warnings.catch_warnings(action="ignore"):  # that errors grow, that elements saturate
        return function(Assumed(**changes))


def outcome(key, value):
    """The verdict on a number by the claim's criterion, also one that it had."""
    claim = published.claims()[key]
    former = FORMER.get(key, claim.criterion)
    return verdict(replace(claim, criterion=former), value)[0]


def row_of(key, values):
    """The row of a claim: its criterion, our number, the range, and what turns the verdict."""
    claim = published.claims()[key]
    ours, verdicts = values["ours"], {name: outcome(key, value) for name, value in values.items()}
    turned = [name for name in values if verdicts[name] != verdicts["ours"]]
    alone = [name for name in turned if not name.startswith("draw ")]
    draws = sum(name.startswith("draw ") for name in values)
    together = len(turned) - len(alone)
    said = [*alone, *([f"{together} of {draws} draws"] if together else [])]
    low, high = min(values.values()), max(values.values())
    link = f"[`{key}`](ledger.md#{key})"
    criterion = FORMER.get(key, claim.criterion)
    return [link, criterion, f"{ours:.3g}", f"{low:.3g} to {high:.3g}", "; ".join(said) or "never"]


def main(groups=GROUPS):
    """The table goes to figures/performance.md."""
    cases = [(group.function, c) for group in groups for c in variations(group).values()]
    found, rows = iter([*run(computed, cases)]), []
    for group in groups:
        results = {name: next(found) for name in variations(group)}
        for key in results["ours"]:
            rows.append(row_of(key, {name: values[key] for name, values in results.items()}))
    titles = ["claim", "criterion", "ours", "range", "turned by"]
    publish("verdicts", table(titles, rows))


if __name__ == "__main__":
    main()
