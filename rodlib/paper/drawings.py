"""The two drawings of the paper: the rod of Fig. 2, and the control scheme of Fig. 3."""

from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle

from rodlib.rod import Rod

MM = 1e3  # per metre


def draw_rod(axes: Axes, rod: Rod) -> None:
    """Draw the rod with its Peltier elements and sensors, to scale along z (the paper's Fig. 2)."""
    axes.set_axis_off()
    length, section = rod.length * MM, rod.length * MM / rod.sections
    centred = {"va": "center"}
    axes.add_patch(Rectangle((0, 0), length, 12, facecolor="0.85", edgecolor="black"))
    axes.text(-4, 6, "insulated", ha="right", fontsize=8, **centred)
    axes.text(length + 4, 6, "insulated", ha="left", fontsize=8, **centred)
    axes.text(length * 0.02, 16, r"air, $\vartheta_a(t)$", **centred)

    red = "tab:red"
    for i in range(rod.sections):
        left, middle = i * section, (i + 0.5) * section
        element = Rectangle((left + 2, -9), section - 4, 8, fc="white", ec="black")
        axes.add_patch(element)
        name = f"Peltier {i + 1}"
        axes.text(middle - 4, -5.2, name, ha="right", fontsize=7, **centred)
        flow = {"arrowstyle": "-|>", "color": red}
        axes.annotate("", (middle, 3), (middle, -17), arrowprops=flow)
        symbol = rf"$\dot Q_{{{i + 1}}}(t)$"
        axes.text(middle + 3, -15, symbol, color=red, **centred)

    blue = "tab:blue"
    for i, z in enumerate(rod.sensors):
        axes.plot(z * MM, 12, "o", color=blue, clip_on=False, zorder=3)
        place = rf"$y_{i + 1}$ at {z * MM:g} mm"
        axes.text(z * MM + 4, 16, place, color=blue, **centred)

    for edge in rod.edges * MM:
        axes.plot([edge, edge], [-24, -21], color="black")
        axes.text(edge, -26, f"{edge:g}", ha="center", va="top")
    along = {"arrowstyle": "->"}
    axes.annotate("", (length + 14, -22.5), (0, -22.5), arrowprops=along)
    axes.text(length + 15, -22.5, "z (mm)", **centred)
    axes.set(xlim=(-40, length + 48), ylim=(-32, 20))


LOOP = (4.35, 0.25, 9.35, 4.6)  # left, bottom, width and height, as of each block
BLOCKS = {
    "$N$": (4.8, 3.4, 1.0, 0.9),
    "plant (12)": (9.3, 3.4, 2.2, 0.9),
    "observer\n(16)": (9.3, 1.2, 2.2, 1.2),
    "$K_s$": (7.35, 0.75, 1.0, 0.8),
    "$L$": (10.0, 6.45, 1.0, 0.9),
    "$Q$": (6.3, 6.45, 1.0, 0.9),
    "memory": (4.1, 5.6, 1.6, 0.7),
}
SUMS = [(7.0, 3.85), (2.9, 3.85), (12.4, 6.9), (8.7, 6.9)]
MINUS = [(6.62, 3.55), (7.32, 3.43), (12.7, 6.48)]
BRANCHES = [(12.4, 3.85), (8.7, 3.85), (1.3, 3.85), (3.5, 6.9)]
SIGNALS = [  # the points of each, from its source on
    # the current-trial loop
    [(5.8, 3.85), (6.78, 3.85)],
    [(7.22, 3.85), (9.3, 3.85)],
    [(10.4, 5.5), (10.4, 4.3)],
    [(11.5, 3.85), (15.0, 3.85)],
    [(12.4, 3.85), (12.4, 1.8), (11.5, 1.8)],
    [(8.7, 3.85), (8.7, 2.15), (9.3, 2.15)],
    [(9.3, 1.75), (7.1, 1.75), (7.1, 3.63)],
    [(9.3, 1.35), (9.0, 1.35), (9.0, 1.15), (8.35, 1.15)],
    [(7.35, 1.15), (6.9, 1.15), (6.9, 3.63)],
    # the learning between trials
    [(0.2, 3.85), (2.68, 3.85)],
    [(3.12, 3.85), (4.8, 3.85)],
    [(12.4, 3.85), (12.4, 6.68)],
    [(1.3, 3.85), (1.3, 7.9), (12.4, 7.9), (12.4, 7.12)],
    [(12.18, 6.9), (11.0, 6.9)],
    [(10.0, 6.9), (8.92, 6.9)],
    [(8.48, 6.9), (7.3, 6.9)],
    [(6.3, 6.9), (2.9, 6.9), (2.9, 4.07)],
    [(3.5, 6.9), (3.5, 5.95), (4.1, 5.95)],
    [(5.7, 5.95), (8.7, 5.95), (8.7, 6.68)],
]
LABELS = {
    "$u$": (7.72, 4.03),
    "$d$": (10.55, 5.3),
    "$y$": (14.4, 4.03),
    r"$\hat\delta$": (8.0, 1.87),
    r"$\hat x$": (8.95, 0.75),
    r"$y^{\mathrm{ref}}$": (0.3, 4.05),
    "$w_{k+1}$": (3.37, 4.03),
    "$e_k$": (11.43, 7.08),
    "$v_{k+1}$": (4.3, 7.08),
    "$v_k$": (6.0, 6.1),
}


def draw_block_diagram(axes: Axes) -> None:
    """Draw the control scheme: ILC around the current-trial loop (the paper's Fig. 3)."""
    axes.set_axis_off()
    axes.set(xlim=(0, 15.2), ylim=(0, 8.2))
    x, y, width, height = LOOP
    axes.add_patch(Rectangle((x, y), width, height, fc="0.94", ec="none"))
    title = "current-trial loop, $P$"
    axes.text(x + 0.15, y + 0.15, title, fontsize=8, color="0.35")

    outlined = {"facecolor": "white", "edgecolor": "black"}
    centred = {"ha": "center", "va": "center"}
    for text, (x, y, width, height) in BLOCKS.items():
        line = "--" if text == "memory" else "-"
        axes.add_patch(Rectangle((x, y), width, height, linestyle=line, **outlined))
        axes.text(x + width / 2, y + height / 2, text, **centred)
    for centre in SUMS:
        axes.add_patch(Circle(centre, 0.22, **outlined))
    for x, y in MINUS:
        axes.text(x, y, "$-$", fontsize=8, **centred)
    for x, y in BRANCHES:
        axes.plot(x, y, "k.", markersize=5)
    for text, (x, y) in LABELS.items():
        axes.text(x, y, text)

    head = {"arrowstyle": "-|>", "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0}
    for points in SIGNALS:
        for (x1, y1), (x2, y2) in pairwise(points[:-1]):
            axes.plot([x1, x2], [y1, y2], color="black", linewidth=1)
        *_, corner, end = points
        axes.add_patch(FancyArrowPatch(corner, end, color="black", **head))
