"""A hundred logs with accidents; ten thousand: make measure WHAT=mutated."""

import mutated


def test_a_log_with_accidents_is_read_or_refused_in_a_few_printable_words():
    counts = mutated.main(100, seed=1)
    assert counts.total() == 100 and counts["read and replayed"] and counts["refused"]
