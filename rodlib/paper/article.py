"""Make the article, as ``make article`` does: article/article.pdf and article/numbers.json.

The text is article/article.typ. It takes its numbers from the ledger by key. The compiler stops if
a key is missing, or if the verdict or the wording of a row is not the one that the text was written
for. numbers.json lists what the text takes from the ledger.
"""

import json
import sys
from pathlib import Path

import typst

from ilctools.files import write_pieces, write_whole
from rodlib.paper.repository import ROOT, checkout


def compiled(root: Path = ROOT) -> tuple[bytes, str]:
    """Compile the article of a clone.

    Return the PDF, and a JSON text that lists what the article takes from the ledger.

    Only the fonts of the compiler are used, and the PDF has no date. The same sources thus give
    the same bytes.
    """
    source = str(root / "article" / "article.typ")
    options = {"root": str(root), "ignore_system_fonts": True}
    pdf, warnings = typst.compile_with_warnings(source, **options)
    if warnings:
        raise RuntimeError(f"{source}: {warnings[0].message}")
    quotes = json.loads(typst.query(source, "<quoted>", field="value", **options))
    return pdf, json.dumps(quotes, indent=1, ensure_ascii=False) + "\n"


def main(root: Path = ROOT) -> None:
    """Write article/article.pdf and article/numbers.json; exit with a message if this fails."""
    try:
        pdf, quotes = compiled(checkout("make article", root))
    except (typst.TypstError, RuntimeError) as error:
        sys.exit(f"the article was not made: {error}")
    write_pieces(root / "article" / "article.pdf", [pdf])
    write_whole(root / "article" / "numbers.json", quotes)


if __name__ == "__main__":
    main()
