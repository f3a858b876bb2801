"""What the compendium itself needs: the printed numbers, the ledger, the figures, make reproduce.

The rest of rodlib does not import from here, but for the notebooks and the tests.
"""
