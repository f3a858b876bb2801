"""What the compendium itself needs: printed numbers, ledger, figures, make reproduce, pages."""
