"""The ILC law, equation (23) of the paper, with limits of commands and outputs, and its files."""
