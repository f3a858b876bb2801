"""What one gets wrong at first: an error that says the remedy, a warning of the cause, or no harm.

Each row is a call, and what is to be said of it; None stands for nothing.
"""

import datetime
import json
import warnings
from pathlib import Path

import control
import numpy as np
import pandas as pd
import pytest
from plants import tanks
from scipy import signal

from rodlib import (
    ClosedLoop,
    Law,
    LearningFilter,
    current_trial_loop,
    load_law,
    load_log,
    multisine,
    paper_loop,
    record,
    run_trials,
    save_law,
    save_log,
    synthesise,
    zero_phase_butterworth,
)
from rodlib.ilc import Controller, replay_of, with_law

LAG = control.ss(0.9, 0.1, 1, 0, 1.0, inputs=["heater"], outputs=["oven"])
LOOP, PAPER = current_trial_loop(LAG), paper_loop()
TANKS = current_trial_loop(tanks(), ["pump A", "pump B", "pump C"])
Q = zero_phase_butterworth()
OMEGA = np.geomspace(1e-3, np.pi, 80)
FFT = 2 * np.pi * np.fft.rfftfreq(200)  # rad/s
CAUSAL = signal.freqz(*signal.butter(2, 0.1 / np.pi), worN=OMEGA)[1]
BAND = {"band": (0.001, 0.02), "L_max": None}
DESIGN = synthesise(LOOP, Q, OMEGA, **BAND)
L = DESIGN.filter
MOVE = 2 * np.sin(np.linspace(0, np.pi, 60)) ** 2
TWO = np.stack([MOVE, 3 * MOVE], axis=1)
L2 = LearningFilter(0.3 * np.eye(2)[:, :, None], 1.0)
LOG = with_law(run_trials(LOOP, Law(Q, L), MOVE, None, 4), Law(Q, L, loop=LOOP))
BOTH = run_trials(PAPER, Law(Q, L2), TWO, None, 2)


def designed(P=LOOP, Q=Q, omega=OMEGA, **more):
    return synthesise(P, Q, omega, **BAND | {"Ts": 1.0} | more)


def sampled(omega=OMEGA):
    return LOOP.frequency_response(omega)


def relearned(e):
    """The log of a law that was programmed elsewhere; e(log) is what it takes for v and e."""
    log = LOG.copy(deep=True)
    for k in range(1, 4):
        v = Law(Q, L).next(*e(log.isel(trial=k - 1)))
        log.v[k] = v
        w = (log.reference[k] + v).values
        log.y[k] = control.forced_response(LOOP.P, inputs=w.T, squeeze=False).outputs.T
    return log.assign(e=log.reference - log.y)


def refused(words, call):
    with (
        warnings.catch_warnings(action="error"),
        pytest.raises(ValueError, match=words),
    ):
        call()


REFUSED = {
    "omega in Hz": (
        "omega ends at 0.5 .* omega is in Hz",
        lambda: designed(P=sampled(FFT), omega=FFT / (2 * np.pi), beyond=0.0),
    ),
    "a causal Q": (
        "Q turns the phase .* runs in one direction only",
        lambda: designed(Q=CAUSAL),
    ),
    "P in seconds and omega in Hz": (
        "omega spans .* likely either is in another unit",
        lambda: designed(omega=1e3 * OMEGA),
    ),
    "v and e exchanged": (
        "v is called 'e' and e 'v': they are exchanged",
        lambda: Law(Q, L).next(LOG.e[0], LOG.v[0]),
    ),
    "columns of other signals": (
        r"reference holds the signals \['T1', 'T2'\], but must hold \['y1', 'y2'\]: rename them",
        lambda: run_trials(
            PAPER, Law(Q, L2), pd.DataFrame(TWO, columns=["T1", "T2"]), None, 2
        ),
    ),
    "no unit": (
        "units: unit 'bananas' of oven is not understood: write it as pint does",
        lambda: current_trial_loop(LAG, units={"oven": "bananas"}),
    ),
    "no unit of an own loop": (
        "units: unit 'bananas' of y is not understood",
        lambda: ClosedLoop(Ts=1.0, outputs=["y"], units={"y": "bananas"}),
    ),
    "an amplitude too many": (
        r"amplitude = \[1.0, 1.0, 1.0\] must be one number, or one for each of the 2 outputs \['y1",
        lambda: multisine(PAPER, 0.01, 1.0, [1, 1, 1], 1.2),
    ),
    "too few hours": (
        "hours = 1.2 is too short for 3 periods .* 1.702 h are needed, or lowest = 0.0142",
        lambda: multisine(TANKS, 0.01, 1.0, [1, 1, 1], 1.2),
    ),
    "scipy's model as a plant": (
        r"(?s)plant = .* StateSpaceDiscrete, and no model: of s = plant.to_ss\(\), make",
        lambda: current_trial_loop(signal.dlti([[0.9]], [[0.1]], [[1]], [[0]], dt=1.0)),
    ),
    "scipy's model as P": (
        r"(?s)P = .* is a TransferFunctionDiscrete, and no model: of s = P.to_ss\(\)",
        lambda: designed(P=signal.dlti([0.1], [1, -0.9], dt=1.0)),
    ),
    "a nonlinear plant": (
        "plant = .* is a NonlinearIOSystem, and no model: linearise it, by control.linearize",
        lambda: current_trial_loop(control.nlsys(None, lambda t, x, u, p: u, dt=1.0)),
    ),
    "a model as Q": (
        r"Q = .* a model, which runs in one direction only: pass zero_phase_butterworth\(",
        lambda: designed(Q=control.tf([0.1], [1, -0.9], 1.0)),
    ),
    "a model as Q of trials": (
        r"Q = .* must be a ZeroPhaseButterworth, .* zero_phase_butterworth\(order, cutoff, Ts\)",
        lambda: run_trials(LOOP, Law(control.tf([0.1], [1, -0.9], 1.0), L), MOVE),
    ),
    "Q and omega exchanged": (
        "omega = .* is a filter: likely exchanged with Q",
        lambda: synthesise(LOOP, OMEGA, Q),
    ),
    "samples of Q and omega exchanged": (
        "omega does not increase, but Q does: likely they are exchanged",
        lambda: designed(P=sampled(), Q=OMEGA, omega=Q.frequency_response(OMEGA)),
    ),
    "a file as P": (
        "P = 'rod.csv' is a path, and no model: read the file",
        lambda: designed(P="rod.csv"),
    ),
    "a path as P": (
        "P = .* is a path, and no model",
        lambda: designed(P=Path("rod.csv")),
    ),
    "a table of five rows": (
        "order = 10 is more than the 5 frequencies of omega tell: take order = 5 or less, or more",
        lambda: designed(P=sampled(OMEGA[::16]), omega=OMEGA[::16]),
    ),
    "a plant that ends where it began": (
        "plant has a zero at z = 1: some constant input leaves no trace in the outputs",
        lambda: current_trial_loop(control.tf([1, -1], [1, -1.2, 0.35], 1.0)),
    ),
    "a design for its filter": (
        "L = .* must be a LearningOperator, which is its attribute: pass L.filter",
        lambda: run_trials(LOOP, Law(Q, DESIGN), MOVE),
    ),
    "a cut-off beyond the Nyquist frequency": (
        r"cutoff = 0.5 must be in \(0, 0.314159\) rad/s.* normalised, as scipy's, times that",
        lambda: zero_phase_butterworth(2, 0.5, Ts=10.0),
    ),
    "a normalised cut-off": (
        "cutoff = 0.01 .* If it is normalised, as scipy's, it is 314.159 rad/s",
        lambda: zero_phase_butterworth(2, 0.01, Ts=1e-4),
    ),
}


@pytest.mark.parametrize(("words", "call"), REFUSED.values(), ids=REFUSED)
def test_an_error_names_the_argument_and_the_remedy(words, call):
    refused(words, call)


SUSPECTED = {
    "seconds for hours": (
        "hours = 10800 are 450 days, 6187 periods .* likely seconds, which are 3 h",
        lambda: multisine(LOOP, 1e-3, 0.1, 1.0, 10800),
    ),
    "L with the wrong sign": (
        r"sigma_max\(M\) reaches 2, but with -L only .* likely L has the wrong sign",
        lambda: run_trials(
            LOOP, Law(Q, LearningFilter(-L.coefficients, 1.0)), MOVE, None, 10
        ),
    ),
    "e with the wrong sign": (
        "v of trial 2 is what the law makes of e with the wrong sign, y - reference",
        lambda: replay_of(relearned(lambda trial: (trial.v.values, -trial.e.values))),
    ),
    "v and e exchanged in the law": (
        "v of trial 2 is what the law makes of v and e exchanged",
        lambda: replay_of(relearned(lambda trial: (trial.e.values, trial.v.values))),
    ),
}


@pytest.mark.parametrize(("words", "call"), SUSPECTED.values(), ids=SUSPECTED)
def test_a_warning_names_the_likely_cause(words, call):
    with warnings.catch_warnings(record=True) as said:
        warnings.simplefilter("always")
        call()
    with pytest.warns(UserWarning, match=words):
        for each in said:
            warnings.warn_explicit(
                each.message, each.category, each.filename, each.lineno
            )
    assert {each.filename for each in said} == {__file__}


def test_names_of_columns_count():
    frame = pd.DataFrame(TWO[:, ::-1], columns=["y2", "y1"])
    assert run_trials(PAPER, Law(Q, L2), frame, None, 2).identical(BOTH)
    turned = BOTH.reference.isel(channel=[1, 0])
    assert run_trials(PAPER, Law(Q, L2), turned, None, 2).identical(BOTH)
    d = {name: np.full(60, float(i)) for i, name in enumerate(PAPER.disturbances)}
    plain = run_trials(PAPER, Law(Q, L2), TWO, np.stack([*d.values()], axis=1), 2)
    d = pd.DataFrame(d)[PAPER.disturbances[::-1]]
    assert run_trials(PAPER, Law(Q, L2), TWO, d, 2, v=0 * frame).identical(plain)
    v, e = BOTH.v[1], BOTH.e[1]
    assert np.array_equal(
        Law(Q, L2).next(v, e.isel(channel=[1, 0])), Law(Q, L2).next(v, e)
    )


def test_numbers_of_columns_do_not():
    assert run_trials(PAPER, Law(Q, L2), pd.DataFrame(TWO), None, 2).identical(BOTH)


class Plain:
    """A rig that is its model."""

    def __init__(self):
        self.x = 0.0

    def begin(self, trial):
        self.x = 0.0

    def read(self):
        return [self.x]

    def apply(self, commands):
        self.x = 0.9 * self.x + 0.1 * commands[0]


def test_one_channel_needs_no_axis():
    column = MOVE[:, None]
    assert run_trials(LOOP, Law(Q, L), MOVE, None, 2, v=MOVE).identical(
        run_trials(LOOP, Law(Q, L), column, None, 2, v=column)
    )
    v = Law(Q, L).next(MOVE, 0.5 * MOVE)
    assert v.shape == MOVE.shape and np.array_equal(
        v[:, None], Law(Q, L).next(column, 0.5 * column)
    )
    made = record(Plain(), LOOP, Law(Q, L), MOVE, trials=2, v=MOVE)
    assert made.identical(record(Plain(), LOOP, Law(Q, L), column, trials=2, v=column))
    assert Controller(LOOP).step([0.0], [1.0]).shape == (1,)
    refused(
        r"reference has shape \(60,\)",
        lambda: run_trials(PAPER, Law(Q, L2), MOVE, None, 2),
    )
    refused(r"v has shape \(60,\)", lambda: Law(Q, L2).next(MOVE, MOVE))


@pytest.mark.parametrize(
    ("changed", "words"),
    [
        (lambda log: log.assign(e=-log.e), "likely it has the wrong sign"),
        (lambda log: log.assign(e=log.v, v=log.e), "likely it is exchanged with v"),
        (
            lambda log: log.assign_attrs(who=object()),
            "attribute 'who' cannot be a line of the log",
        ),
    ],
)
def test_a_log_that_contradicts_itself_is_refused(tmp_path, changed, words):
    refused(words, lambda: save_log(changed(LOG), tmp_path / "log.csv"))


def test_times_are_noted_as_they_are(tmp_path):
    when = datetime.datetime(2024, 2, 29, 12, 30)
    notes = {"when": when, "day": when.date(), "numpy": np.datetime64("2024-02-29")}
    notes |= {"all": [when], "array": np.array([1.5])}
    save_log(LOG.assign_attrs(notes), tmp_path / "log.csv")
    read = load_log(tmp_path / "log.csv").attrs
    assert datetime.datetime.fromisoformat(read["when"]) == when
    assert read["day"] == read["numpy"] == "2024-02-29"
    assert json.loads(read["all"]) == [when.isoformat()] and json.loads(
        read["array"]
    ) == [1.5]


def test_a_log_and_a_law_are_told_apart(tmp_path):
    save_log(LOG, tmp_path / "log.csv")
    save_law(tmp_path / "law.json", Law(Q, L))
    refused(
        r"is no law but a table: .*law_of\(load_log\(",
        lambda: load_law(tmp_path / "log.csv"),
    )
    refused("load_law reads laws", lambda: load_log(tmp_path / "law.json"))


def test_a_log_with_a_gap_is_loaded_with_a_warning(tmp_path):
    save_log(LOG.sel(trial=[1, 3]), tmp_path / "log.csv")
    with pytest.warns(
        UserWarning, match=r"log.csv': trial 2 is missing between others"
    ):
        assert load_log(tmp_path / "log.csv").trial.values.tolist() == [1, 3]
    save_log(LOG.sel(trial=[3, 4]), tmp_path / "log.csv")
    load_log(tmp_path / "log.csv")  # which goes on where another ends
