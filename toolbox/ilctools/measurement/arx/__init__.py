"""The estimator, a regularised ARX model of one output; `regression` is its entry point."""
