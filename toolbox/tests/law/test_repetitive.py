"""The law without a reset against law and loop written out, its theorem, and what it refuses."""

import warnings
from dataclasses import replace
from functools import cache

import numpy as np
import pytest
from plants import LOOPS, ModelRig
from scipy.signal import butter, freqz_sos
from written_out import simulated

from ilctools import (
    Law,
    LearningFilter,
    NormOptimal,
    load_log,
    record,
    replay,
    run_trials,
    synthesise,
    zero_phase_butterworth,
)
from ilctools.law.repetitive import NEGLIGIBLE_OF_M, check_period, finite_response

CUTOFFS = {"stage": 200.0, "tanks": 0.15, "furnace": 0.1}


@cache
def law_for(name):
    """A loop with a law whose rate is below one."""
    loop = LOOPS[name]()
    Q = zero_phase_butterworth(2, CUTOFFS[name], loop.Ts)
    return loop, synthesise(loop, Q, order=16, L_max=20.0).law()


def taps(Q, length):
    """Impulse response of the zero-phase filter, by the integral over its frequency response."""
    points = 2**16
    omega = 2 * np.pi * np.arange(points // 2 + 1) / points
    _, H = freqz_sos(butter(Q.order, Q.cutoff * Q.Ts / np.pi, output="sos"), omega)
    h = np.fft.irfft(np.abs(H) ** 2)
    return np.append(h[length:0:-1], h[: length + 1])


def asked(law, v, e, period):
    """What (23) asks of v in endless time, a period longer than v is, by taps that are not ours."""
    x = v.copy()
    for k in range(law.L.order):
        x[: -1 - k] += e[1 + k :] @ law.L.coefficients[..., k].T
    h = taps(law.Q, len(finite_response(law)) // 2)
    x = np.apply_along_axis(np.convolve, 0, x, h, "same")
    return np.vstack([0 * v[:period], (1 - law.gain) * v + law.gain * x])


def signals(loop, period=300):
    """A reference and a disturbance of that period that never rest."""
    phase = 2 * np.pi * np.arange(period)[:, None] / period
    m, sources = len(loop.outputs), len(loop.disturbances)
    r = 2 + np.sin(phase + np.arange(m)) + 0.3 * np.sin(3 * phase + 1)
    return r, 0.2 * np.cos(2 * phase + np.arange(sources))


def lines(run):
    """v, u, y, e of endless time, (time, m)."""
    return (np.concatenate(run[name].values) for name in "vuye")


def assert_close(actual, expected, rtol):
    np.testing.assert_allclose(actual, expected, rtol=0, atol=rtol * np.abs(expected).max())


@pytest.mark.parametrize(("name", "gain"), [*zip(CUTOFFS, [1.0, 0.6, 1.0], strict=True)])
def test_trials_are_the_law_and_the_loop_written_out(name, gain):
    """In simulation, of signals that differ at every border, with noise."""
    loop, law = law_for(name)
    law, (r, d) = replace(law, gain=gain), signals(loop)
    noise = 0.01 * np.random.default_rng(0).standard_normal((3, *r.shape))
    run = run_trials(loop, law, r, d, 3, noise=noise, reset=False)
    (v, u, y, e), r, d = lines(run), np.tile(r, (3, 1)), np.tile(d, (3, 1))
    readings, commands, _ = simulated(loop, loop.plant, r + v, d, np.concatenate(noise))
    for pair in (y, readings), (u, commands), (e, r - y), (v, asked(law, v, e, 300)[:900]):
        assert_close(*pair, 1e-8)
    # and with filters that end at the border it is another thing
    ends = law.next(run.v[1].values, run.e[1].values)
    assert np.abs(ends - run.v[2]).max() > 1e-3 * np.abs(v).max()


@pytest.mark.parametrize("name", CUTOFFS)
def test_a_rig_that_never_rests_is_that_loop_and_its_log_replays(name, tmp_path):
    """Within limits, by which some commands are cut off."""
    loop, law = law_for(name)
    (r, d), rig = signals(loop), ModelRig(loop.plant)
    _, u, *_ = lines(run_trials(loop, law, r, trials=3, reset=False))
    high = 0.8 * np.abs(u).max(axis=0)
    law = replace(law, limits={n: (-h, h) for n, h in zip(loop.controls, high, strict=True)})
    with warnings.catch_warnings(action="ignore"):  # that commands are cut off
        log = record(rig, loop, law, r, trials=3, path=tmp_path / "log.csv", reset=False)
        again = replay(load_log(tmp_path / "log.csv"))
    (v, u, y, e), sent = lines(log), np.array(rig.sent)[:, : r.shape[1]]
    assert len(sent) == 900 and rig.ends == 1
    within = np.clip(u, -high, high)
    realised = v + np.linalg.solve(loop.N, (sent - u).T).T
    w = np.tile(r, (3, 1)) + realised
    readings, commands, _ = simulated(loop, loop.plant, w, np.zeros((900, d.shape[1])))
    expected = asked(law, realised, e, 300)
    for pair in (sent, within), (y, readings), (sent, commands), (v, expected[:900]):
        assert_close(*pair, 1e-7)
    assert again.departure is None and "not checked" in again.agreement
    size = np.abs(v).max()
    np.testing.assert_allclose(again.simulated.v, log.v, atol=1e-7 * size)
    # what follows, of which nothing is cut off yet
    following = again.following
    assert 0 < len(following) < 300
    np.testing.assert_allclose(following, expected[900:][: len(following)], atol=1e-7 * size)


@pytest.mark.parametrize(("name", "gain"), [("tanks", 0.6), ("furnace", 1.0)])
def test_error_is_within_the_bound_of_the_theorem_and_becomes_periodic(name, gain):
    loop, law = law_for(name)
    law, trials, period = replace(law, gain=gain), 100, 400
    r, d = signals(loop, period)
    # from any start, with any first signal
    start = {"initial_state": np.ones(len(loop.plant.A)), "v": 1 + r} if gain < 1 else {}
    e = run_trials(loop, law, r, d, trials, reset=False, **start).e.values
    free = run_trials(loop, Law(law.Q, None), r, d, 10, reset=False).e.values
    # at every harmonic, with Q = 1 at frequency zero
    omega = 2 * np.pi * np.fft.rfftfreq(period, loop.Ts)
    omega[0] = 1e-9 / loop.Ts
    q, P = law.Q.frequency_response(omega)[:, None, None], loop.frequency_response(omega)
    one = np.eye(r.shape[1])
    M = q * (one - P @ law.L.frequency_response(omega))
    gamma = np.linalg.norm(M, 2, axis=(1, 2)).max()
    left = (1 - q) * np.fft.rfft(free[-1], axis=0)[..., None]  # e = M e + (1 - Q) e_0
    expected = np.fft.irfft(np.linalg.solve(one - M, left)[..., 0], period, axis=0)
    settled = 3 * max(1e-5, (1 - gain + gain * gamma) ** trials) * np.abs(free[0]).max()
    np.testing.assert_allclose(e[-1], expected, atol=settled)
    if gain == 1:  # the energy, to any time, with f by taps of Q that are not ours
        f = np.concatenate([free, np.repeat(free[-1:], trials - len(free), axis=0)]).reshape(e.size)
        filtered = np.convolve(f, taps(law.Q, len(finite_response(law)) // 2), "same")
        f[period:] -= filtered[:-period]
        spent, given = np.cumsum(e.ravel() ** 2), np.cumsum(f**2)
        assert np.all(np.sqrt(spent) <= np.sqrt(given) / (1 - gamma) * (1 + 1e-4))


@pytest.mark.parametrize("gain", [0.5, 1e5])
@pytest.mark.parametrize(("order", "cutoff"), [(1, 0.02), (2, 0.1), (5, 1.0), (2, 3.0)])
def test_what_is_cut_off_of_Q_is_negligible_for_M_and_no_more(gain, order, cutoff):
    L, share = LearningFilter([[[gain]]], 1.0), NEGLIGIBLE_OF_M / max(1, gain)
    Q = zero_phase_butterworth(order, cutoff, 1.0)
    h = finite_response(Law(Q, L))
    R, omega = len(h) // 2, np.pi * np.arange(2**14 + 1) / 2**14
    response = np.abs(np.fft.rfft(h, 2**15))  # but for the delay of R samples
    off = np.abs(response - Q.frequency_response(omega)).max()
    assert off <= share * (1 + 1e-6) + 1e-13
    assert 2 * np.abs(taps(Q, R + 2000)[:2001]).sum() > 0.99 * share or R == 0
    np.testing.assert_allclose(h, taps(Q, R), atol=1e-12)


def test_a_period_that_is_too_short_and_what_has_no_meaning_are_refused():
    loop, law = law_for("tanks")
    needed = len(finite_response(law)) // 2 + law.L.order + 1
    check_period(law, needed)
    check_period(Law(law.Q, None), 10)
    optimal = Law(law.Q, NormOptimal(loop.P, 0.1, 300))
    for wrong, period, message in (
        (law, needed - 1, f"{needed - 1} samples .* needs {needed} or more"),
        (replace(law, rest=5), 300, "rest = 5, but without reset"),
        (optimal, 300, "L = "),
    ):
        with pytest.raises(ValueError, match=message):
            run_trials(loop, wrong, np.zeros((period, 3)), reset=False)
    with pytest.raises(ValueError, match="reset = False, but pause = 3"):
        record(ModelRig(loop.plant), loop, law, np.zeros((300, 3)), pause=3, reset=False)


def test_an_experiment_with_resets_does_not_go_on_without_and_learning_does(tmp_path):
    """Begun once, in the first trial that is run; what was learned goes on from the log."""
    loop, law = law_for("tanks")
    r, _ = signals(loop)
    begun = []

    class Rig(ModelRig):
        def begin(self, trial):
            begun.append(trial)
            self.x = 0 * self.x

    task = {"rig": Rig(loop.plant), "loop": loop, "law": law, "reference": r}
    task["path"] = tmp_path / "log.csv"
    record(**task, trials=2, reset=False)
    with pytest.raises(ValueError, match="which differs in reset"):
        record(**task, trials=3)
    with warnings.catch_warnings(action="ignore"):  # a start is a disturbance
        log = record(**task, trials=3, reset=False)
    assert begun == [1, 3]
    v, _, _, e = lines(log)
    assert_close(v, asked(law, v, e, 300)[: len(v)], 1e-7)
    assert np.abs(log.y[2, 0]).max() < 1e-12 < np.abs(log.y[1, 0]).max()


def test_samples_are_due_by_one_clock():
    """What takes long between two trials makes the next sample late."""
    loop, law = law_for("tanks")
    r, _ = signals(loop)

    class Rig(ModelRig):
        time = 0.0

        def clock(self):
            return self.time

        def apply(self, commands):
            super().apply(commands)
            self.time += loop.Ts + (0.5 * loop.Ts if len(self.sent) == 300 else 0)

    with pytest.warns(UserWarning, match="trial 2: 300 samples were not on time"):
        record(Rig(loop.plant), loop, law, r, trials=2, reset=False)
