"""The estimator: a regularised ARX model of one output, step by step; `regression` is its door."""
