"""Logs with accidents: each is read, or refused in a few printable words, in seconds.

`make measure WHAT=mutated` mutates logs of several kinds ten thousand times, from one seed on
(`SEED=1 make measure WHAT=mutated`), and counts what became of them. A LogError and a ValueError
are answers; anything else ends the run, with the log that led to it.
"""

import os
import tempfile
import time
import warnings
from collections import Counter
from pathlib import Path

import control
import numpy as np

from ilctools import (
    ClosedLoop,
    Law,
    LearningFilter,
    law_of,
    load_log,
    replay,
    run_trials,
    save_log,
    zero_phase_butterworth,
)
from ilctools.law.notes import with_law
from rodlib.paper.repository import ROOT

COUNT, SLOW = 10_000, 20.0  # s, for which nobody waits
HOSTILE = [
    *["-1", "0", "1e999", "nan", "1e-99", "1e-7", "1" * 5000, "1_000", "٣", "null", "{}", "[]"],
    *['"', "\\", '"\\b"', '"\\ud800"', "\\u202e", "\x1b[2J", "\x85", "\u200b", "\x00", "\ufeff"],
    *["\n", "\r", ",", "#", ":", "# Ts: 1 s\n", "[" * 2000, '{"a": 1, "a": 2}', "$\\frac{$"],
]


def logs() -> list[str]:
    """Logs with a law and a loop, without a reset, with limits; and one written by hand."""
    readme = (ROOT / "data" / "README.md").read_text(encoding="utf-8")
    texts = [readme.split("```text\n")[1].split("```")[0]]
    model = control.ss(0.8, 0.2, 1, 0, 0.1, inputs=["w"], outputs=["x"])
    loop = ClosedLoop(model, units={"x": "mm"})
    Q, L = zero_phase_butterworth(2, 3.0, 0.1), LearningFilter([[[0.5]]], 0.1)
    reference = np.sin(np.pi * np.arange(90) / 90) ** 2
    for limits, reset in (({}, True), ({}, False), ({"w": (-0.5, 0.9)}, True)):
        law = Law(Q, L, limits=limits, loop=loop)
        with warnings.catch_warnings(action="ignore"), tempfile.TemporaryDirectory() as folder:
            run = run_trials(loop, law, reference, trials=3, reset=reset)
            save_log(with_law(run, law), Path(folder) / "log.csv")
            texts.append((Path(folder) / "log.csv").read_text(encoding="utf-8"))
    return texts


def mutated(text: str, random: np.random.Generator) -> bytes:
    """A log after one to three accidents: most of them in its head."""
    for _ in range(random.integers(1, 4)):
        head = text.rfind("\n#") + 200 if random.random() < 0.7 else len(text)
        start = int(random.integers(0, max(1, min(head, len(text)))))
        end = start + int(random.choice([0, 1, 3, 30, 3000], p=[0.3, 0.3, 0.2, 0.15, 0.05]))
        kind = random.integers(4)
        if kind == 0:
            new = ""
        elif kind == 1:
            new = 2 * text[start:end]
        else:
            new = HOSTILE[random.integers(len(HOSTILE))]
        text = text[:start] + new + text[end:]
    return text.encode(errors="surrogatepass")


def outcome(content: bytes, path: Path) -> str:
    """What becomes of a log; an AssertionError if its words are not printable, few and soon."""
    path.write_bytes(content)
    start, said = time.perf_counter(), "read and replayed"
    try:
        with warnings.catch_warnings(action="ignore"):
            log = load_log(path)
            said, text = "read, its notes refused", ""
            law_of(log)
            text = str(replay(log))
            said = "read and replayed"
    except ValueError as error:
        said = "refused" if said == "read and replayed" else said
        text = str(error)
        assert len(text) < 5000
    assert text.replace("\n", "").isprintable(), text
    assert time.perf_counter() - start < SLOW
    return said


def main(count=COUNT, seed=0) -> Counter:
    """So many mutated logs, and what became of them."""
    random, texts, counts = np.random.default_rng(seed), logs(), Counter()
    with tempfile.TemporaryDirectory() as folder:
        for k in range(count):
            content = mutated(texts[k % len(texts)], random)
            try:
                counts[outcome(content, Path(folder) / "log.csv")] += 1
            except BaseException:
                print(f"log {k} of seed {seed}: {content!r}")
                raise
    return counts


if __name__ == "__main__":
    for words, number in main(seed=int(os.environ.get("SEED", 0))).most_common():
        print(f"{number:6} {words}")
