"""The two drawings of the paper: the rod of Fig. 2, and the control scheme of Fig. 3."""

from itertools import pairwise

from matplotlib.axes import Axes
from matplotlib.patches import Circle, FancyArrowPatch, Rectangle

from rodlib.rod import Rod


def draw_rod(axes: Axes, rod: Rod) -> None:
    """Draw the rod with its Peltier elements and sensors, to scale along z (the paper's Fig. 2)."""
    axes.set_axis_off()
    length, section = rod.length * 1e3, rod.length * 1e3 / rod.sections
    axes.add_patch(Rectangle((0, 0), length, 12, facecolor="0.85", edgecolor="black"))
    axes.text(-4, 6, "insulated", ha="right", va="center", fontsize=8)
    axes.text(length + 4, 6, "insulated", ha="left", va="center", fontsize=8)
    for i in range(rod.sections):
        middle = (i + 0.5) * section
        axes.add_patch(
            Rectangle(
                (i * section + 2, -9),
                section - 4,
                8,
                facecolor="white",
                edgecolor="black",
            )
        )
        axes.text(
            middle - 4, -5.2, f"Peltier {i + 1}", ha="right", va="center", fontsize=7
        )
        axes.annotate(
            "",
            (middle, 3),
            (middle, -17),
            arrowprops={"arrowstyle": "-|>", "color": "tab:red"},
        )
        axes.text(
            middle + 3, -15, rf"$\dot Q_{{{i + 1}}}(t)$", color="tab:red", va="center"
        )
    for i, z in enumerate(rod.sensors):
        axes.plot(z * 1e3, 12, "o", color="tab:blue", clip_on=False, zorder=3)
        axes.text(
            z * 1e3 + 4,
            16,
            rf"$y_{i + 1}$ at {z * 1e3:g} mm",
            color="tab:blue",
            va="center",
        )
    axes.text(length * 0.02, 16, r"air, $\vartheta_a(t)$", va="center")
    for edge in rod.edges * 1e3:
        axes.plot([edge, edge], [-24, -21], color="black")
        axes.text(edge, -26, f"{edge:g}", ha="center", va="top")
    axes.annotate("", (length + 14, -22.5), (0, -22.5), arrowprops={"arrowstyle": "->"})
    axes.text(length + 15, -22.5, "z (mm)", va="center")
    axes.set_xlim(-40, length + 48)
    axes.set_ylim(-32, 20)


def draw_block_diagram(axes: Axes) -> None:
    """Draw the control scheme: ILC around the current-trial loop (the paper's Fig. 3)."""
    axes.set_axis_off()
    axes.set_xlim(0, 15.2)
    axes.set_ylim(0, 8.2)

    def block(x, y, width, height, text, **style):
        box = Rectangle(
            (x, y), width, height, facecolor="white", edgecolor="black", **style
        )
        axes.add_patch(box)
        axes.text(x + width / 2, y + height / 2, text, ha="center", va="center")

    def arrow(*points, label="", offset=(0.1, 0.25)):
        for start, stop in pairwise(points[:-1]):
            axes.plot(*zip(start, stop, strict=True), color="black", linewidth=1)
        head = {"arrowstyle": "-|>", "mutation_scale": 9, "shrinkA": 0, "shrinkB": 0}
        axes.add_patch(FancyArrowPatch(*points[-2:], color="black", **head))
        axes.text(points[0][0] + offset[0], points[0][1] + offset[1], label)

    def sum_at(x, y, *signs):
        axes.add_patch(Circle((x, y), 0.22, facecolor="white", edgecolor="black"))
        for dx, dy, sign in signs:
            axes.text(x + dx, y + dy, sign, fontsize=8, ha="center", va="center")

    # the current-trial loop
    axes.add_patch(
        Rectangle((4.35, 0.25), 9.35, 4.6, facecolor="0.94", edgecolor="none")
    )
    axes.text(4.5, 0.4, "current-trial loop, $P$", fontsize=8, color="0.35")
    block(4.8, 3.4, 1.0, 0.9, "$N$")
    sum_at(7.0, 3.85, (-0.38, -0.3, "$-$"), (0.32, -0.42, "$-$"))
    block(9.3, 3.4, 2.2, 0.9, "plant (12)")
    block(9.3, 1.2, 2.2, 1.2, "observer\n(16)")
    block(7.35, 0.75, 1.0, 0.8, "$K_s$")
    arrow((5.8, 3.85), (6.78, 3.85))
    arrow((7.22, 3.85), (9.3, 3.85), label="$u$", offset=(0.5, 0.18))
    arrow((10.4, 5.5), (10.4, 4.3), label="$d$", offset=(0.15, -0.2))
    arrow((11.5, 3.85), (15.0, 3.85), label="$y$", offset=(2.9, 0.18))
    arrow((12.4, 3.85), (12.4, 1.8), (11.5, 1.8))
    arrow((8.7, 3.85), (8.7, 2.15), (9.3, 2.15))
    arrow(
        (9.3, 1.75),
        (7.1, 1.75),
        (7.1, 3.63),
        label=r"$\hat\delta$",
        offset=(-1.3, 0.12),
    )
    arrow((9.3, 1.35), (9.0, 1.35), (9.0, 1.15), (8.35, 1.15))
    axes.text(8.95, 0.75, r"$\hat x$")
    arrow((7.35, 1.15), (6.9, 1.15), (6.9, 3.63))
    # the learning between trials
    sum_at(2.9, 3.85)
    arrow((0.2, 3.85), (2.68, 3.85), label=r"$y^{\mathrm{ref}}$", offset=(0.1, 0.2))
    arrow((3.12, 3.85), (4.8, 3.85), label="$w_{k+1}$", offset=(0.25, 0.18))
    axes.plot(12.4, 3.85, "k.", markersize=5)
    axes.plot(8.7, 3.85, "k.", markersize=5)
    axes.plot(1.3, 3.85, "k.", markersize=5)
    sum_at(12.4, 6.9, (0.3, -0.42, "$-$"))
    arrow((12.4, 3.85), (12.4, 6.68))
    arrow((1.3, 3.85), (1.3, 7.9), (12.4, 7.9), (12.4, 7.12))
    block(10.0, 6.45, 1.0, 0.9, "$L$")
    arrow((12.18, 6.9), (11.0, 6.9), label="$e_k$", offset=(-0.75, 0.18))
    sum_at(8.7, 6.9)
    arrow((10.0, 6.9), (8.92, 6.9))
    block(6.3, 6.45, 1.0, 0.9, "$Q$")
    arrow((8.48, 6.9), (7.3, 6.9))
    block(4.1, 5.6, 1.6, 0.7, "memory", linestyle="--")
    arrow((6.3, 6.9), (2.9, 6.9), (2.9, 4.07), label="$v_{k+1}$", offset=(-2.0, 0.18))
    arrow((3.5, 6.9), (3.5, 5.95), (4.1, 5.95))
    arrow((5.7, 5.95), (8.7, 5.95), (8.7, 6.68), label="$v_k$", offset=(0.3, 0.15))
    axes.plot(3.5, 6.9, "k.", markersize=5)
