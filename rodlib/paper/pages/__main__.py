"""``python -m rodlib.paper.pages``."""

from rodlib.paper.pages import main

main()
