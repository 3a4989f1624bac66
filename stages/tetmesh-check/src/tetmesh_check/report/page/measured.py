"""The parts of the page that show measures: quality, distance, what was solved, and how the particles settled."""

from __future__ import annotations

from html import escape
from typing import Any

from tetmesh_check.checks import percent
from tetmesh_check.report.page.case import Case, dig
from tetmesh_check.report.page.charts import Axis, Limit, curve, histogram, number
from tetmesh_check.report.page.html import duration, figure, section, table

_MEASURES = (
    ("radius_ratio", "radius ratio", "1 is regular"),
    ("scaled_jacobian", "scaled Jacobian", "1 is regular"),
    ("min_dihedral", "minimum dihedral angle, degrees", "70.5 is regular"),
    ("max_dihedral", "maximum dihedral angle, degrees", "70.5 is regular"),
    ("aspect_ratio", "aspect ratio", "1 is regular"),
    ("edge_ratio", "longest over shortest edge", "1 is regular"),
    ("edge_length", "edge length, mm", ""),
)
_PROBLEMS = {
    "poisson": "Poisson's equation, known solution",
    "conduction": "Excitation wave in tissue with fibres",
    "elasticity": "Soft organ under its own weight",
    "forward": "Current source in one of several materials",
}

_NO_DIFFERENCE = 1e-3
"""Differences of forces below this, percent, are written as less than it."""


def _histogram(
    summary: dict[str, Any],
    axis: Axis,
    worst: str,
    limit: Limit | None = None,
    second: bool = False,
    end: int | None = None,
) -> str:
    edges, counts = summary["histogram"]["edges"], summary["histogram"]["counts"][:end]
    beyond = summary["count"] - summary["infinite"] - sum(counts)
    below = sum(edge < 0 for edge in edges[:-1])
    if not any(counts[:below]):  # half of the range of a scaled Jacobian is for inverted tetrahedra
        edges, counts = edges[below:], counts[below:]
    marks = {"mean": summary["mean"], worst: summary["max" if worst == "maximum" else "min"]}
    return histogram(edges[: len(counts) + 1], counts, axis, marks, limit, second, beyond)


def _limit(case: Case, name: str) -> Limit | None:
    """The limit of a check of ``tetmesh-check``."""
    value = next((check.get("limit") for check in case.checks if check.get("name") == name), None)
    return None if value is None else Limit(float(value))


def _surface_charts(case: Case, triangles: dict[str, Any]) -> list[str]:
    allowed = dig(case.reports, "reconstruct", "results", "check", "min_radius_ratio_allowed")
    return [
        figure(
            _histogram(
                triangles["radius_ratio"],
                Axis("Surface triangles", "radius ratio", "triangles"),
                "minimum",
                None if allowed is None else Limit(float(allowed)),
            ),
            "Twice the inradius over the circumradius, the measure of the paper's Fig. 9: 1 is equilateral.",
        ),
        figure(
            _histogram(
                triangles["min_angle"], Axis("Surface triangles", "minimum angle, degrees", "triangles"), "minimum"
            ),
            "The minimum angle of each triangle: 60 degrees is equilateral. No check limits it.",
        ),
    ]


def _tetrahedra_charts(case: Case, tetrahedra: dict[str, Any]) -> list[str]:
    def chart(name: str, measure: str, check: str = "", end: int | None = None) -> str:
        axis = Axis("Tetrahedra", measure, "tetrahedra")
        return _histogram(tetrahedra[name], axis, "minimum", _limit(case, check), True, end)

    return [
        figure(
            chart("radius_ratio", "radius ratio"),
            "Three times the inradius over the circumradius: 1 is regular. No check limits it.",
        ),
        figure(
            chart("min_dihedral", "minimum dihedral angle, degrees", "min_dihedral", 24),
            "The minimum angle between two faces of each tetrahedron: 70.5 degrees is regular.",
        ),
        figure(
            chart("scaled_jacobian", "scaled Jacobian", "min_scaled_jacobian"),
            "The Jacobian over the largest product of three edges at a vertex: 1 is regular, 0 is flat.",
        ),
    ]


def _size_charts(case: Case, volume: dict[str, Any]) -> list[str]:
    charts = []
    if "histogram" in (sizes := case.results.get("sizing", {}).get("at_surface", {})):
        axis = Axis("h on the surface", "target edge length, mm", "vertices")
        charts.append(
            figure(
                _histogram(sizes, axis, "maximum"),
                "The target edge length of the size field, at the vertices of the surface.",
            )
        )
    if (over := volume.get("edge_length_over_target")) is not None:
        charts.append(
            figure(
                _histogram(over, Axis("Tetrahedra", "edge length over target", "tetrahedra"), "maximum", None, True),
                "The mean edge length of each tetrahedron over the target edge length there.",
            )
        )
    return charts


def quality(case: Case) -> str:
    """Write histograms and percentiles of quality.

    Parameters
    ----------
    case
        The case.
    """
    if (volume := case.results.get("volume")) is None:
        return _surface_alone(case)
    many = case.results.get("complex")
    triangles, tetrahedra = (many or case.results["surface"])["quality"], volume["quality"]
    charts = [
        *_surface_charts(case, triangles),
        *_tetrahedra_charts(case, tetrahedra),
        *_size_charts(case, volume),
    ]
    rows = [
        (
            escape(name) + (f' <span class="soft">({remark})</span>' if remark else ""),
            *(number(s[key]) for key in ("min",)),
            *(number(s["percentiles"][key]) for key in ("p1", "p5", "p50", "p95", "p99")),
            number(s["max"]),
            number(s["mean"]),
        )
        for key_name, name, remark in _MEASURES
        for s in (tetrahedra[key_name],)
    ]
    numbers = "<h3>Tetrahedra in numbers</h3>" + table(
        ("tetrahedra", "minimum", "1 %", "5 %", "median", "95 %", "99 %", "maximum", "mean"), rows
    )
    shown = f'<div class="grid">{"".join(charts)}</div>'
    return section("Quality", shown + numbers + (_distances(case) if many is None else _kept(volume)))


def _surface_alone(case: Case) -> str:
    """What ``reconstruct`` measured, where there are no tetrahedra."""
    check = dig(case.reports, "reconstruct", "results", "check")
    if check is None or not check["triangles"]:
        return ""
    shape = check["quality"]
    counts = shape["radius_ratio_histogram"]
    edges = [k / len(counts) for k in range(len(counts) + 1)]
    marks = {"mean": shape["radius_ratio_mean"], "minimum": shape["radius_ratio_min"]}
    allowed = check.get("min_radius_ratio_allowed")
    limit = None if allowed is None else Limit(float(allowed))
    chart = figure(
        histogram(edges, counts, Axis("Surface triangles", "radius ratio", "triangles"), marks, limit),
        "Twice the inradius over the circumradius, the measure of the paper's Fig. 9: 1 is equilateral.",
    )
    rows = [
        ("angles, degrees", number(shape["angle_min"]), "-", number(shape["angle_max"])),
        ("edge length, mm", *(number(shape[f"edge_length_{key}"]) for key in ("min", "mean", "max"))),
        ("radius ratio", number(shape["radius_ratio_min"]), number(shape["radius_ratio_mean"]), "-"),
    ]
    return section(
        "Quality", f'<div class="grid">{chart}</div>' + table(("triangles", "minimum", "mean", "maximum"), rows)
    )


def _kept(volume: dict[str, Any]) -> str:
    """What became of the triangles between materials."""
    triangles = volume["interface_triangles"]
    words = (
        "Every triangle between two materials is a face of one tetrahedron of each, with unchanged coordinates. No "
        "other faces lie between two materials."
        if volume["interfaces_kept"]
        else f"{number(triangles['missing'])} triangles between materials are not faces of the tetrahedra."
    )
    return f"<h3>Tetrahedra against the surface</h3><p>{words}</p>"


def _distances(case: Case) -> str:
    distance, volume = case.results["distance_mm"], case.results["volume"]
    before = case.results["surface"]["volume_mm3"]
    change = 100.0 * (volume["volume_mm3"] / before - 1.0)
    rows = [
        (words, number(s["mean"]), number(s["p99"]), number(s["max"]))
        for words, s in (
            ("from the boundary of the tetrahedra to the surface", distance["boundary_to_surface"]),
            ("from the surface to the boundary of the tetrahedra", distance["surface_to_boundary"]),
        )
    ]
    kept = (
        "has the triangles of the surface, unchanged"
        if volume["boundary_kept"]
        else "has new triangles within the envelope"
    )
    return (
        "<h3>Tetrahedra against the surface</h3>"
        + table(("distance, mm", "mean", "99 %", "maximum"), rows)
        + f"<p>The boundary of the tetrahedra {kept}. Their volume differs from that of the surface by {percent(change)}.</p>"
    )


def _small(percent: float) -> str:
    """A difference, percent, that only rounding causes."""
    return "less than 0.001" if percent < _NO_DIFFERENCE else number(percent, 2)


def solve(case: Case) -> str:
    """Write what the problems solved on the mesh say.

    Parameters
    ----------
    case
        The case.
    """
    results = case.results.get("solve")
    if results is None:
        return ""
    rows = []
    for name, title in _PROBLEMS.items():
        if name not in results or "unknowns" not in results[name] or results[name]["unknowns"] == 0:
            continue
        figures = results[name]
        said = {
            "poisson": lambda f: (
                f"error {number(100 * f['relative_l2_error'], 2)} % of the known solution, "
                f"{number(100 * f['relative_h1_error'], 2)} % of its gradient ({f['best_approximation']:.2f} times the "
                "error of interpolation)"
            ),
            "conduction": lambda f: (
                f"potential {f['potential_range_mv'][0]:.1f} to {f['potential_range_mv'][1]:.1f} mV"
            ),
            "elasticity": lambda f: (
                f"{number(100 * f['load_share'], 2)} % of its weight moves it by at most "
                f"{number(100 * f['displacement_share'], 2)} % of its size ({number(f['max_displacement_mm'])} mm); "
                f"reaction and load differ by {_small(100 * abs(f['reaction_n'] / (f['load_share'] * f['weight_n']) - 1))} %"
            ),
            "forward": lambda f: f"potential {f['potential_range_mv'][0]:.1f} to {f['potential_range_mv'][1]:.1f} mV",
        }[name](figures)
        rows.append(
            (
                title,
                number(figures["unknowns"]),
                number(figures[figures.get("solved_with", "multigrid")]["iterations"]),
                duration(figures["seconds"]),
                said,
            )
        )
    missing = "Not every test problem was solved" if rows else "No test problem was solved"
    reason = "" if results["reason"] is None else f"<p>{missing}: {escape(results['reason'])}.</p>"
    if not rows:
        return section("Solve", reason)
    columns = ("problem", "unknowns", "CG iterations", "time", "result")
    return section(
        "Solve",
        "<p>Linear elements, solved by conjugate gradients (CG) with multigrid. Fewer "
        "iterations mean that the mesh is easier for any solver. Linear elasticity holds for small displacements "
        "only, so the load is the share of the weight that moves the organ by at most 1 % of its "
        f"size.</p>{table(columns, rows, (0, 4))}{reason}",
    )


def _on_junctions(case: Case) -> str:
    """A sentence about particles that ``particles`` does not move, and so does not count in its passes."""
    total = str(dig(case.reports, "particles", "results", "particles") or "")
    fixed = int(total) - int(case.passes[-1]["count"]) if total.isdigit() else 0
    return f" The {number(fixed)} particles on junction curves are not counted here." if fixed > 0 else ""


def particles(case: Case) -> str:
    """Write how the particles settled.

    Parameters
    ----------
    case
        The case.
    """
    if len(case.passes) < 2:
        return ""
    steps = [float(k + 1) for k in range(len(case.passes))]
    energy = curve(steps, [row["energy"] for row in case.passes], "Energy of the particles", "pass", "energy")
    count = curve(steps, [row["count"] for row in case.passes], "Number of particles", "pass", "particles", True)
    last = case.passes[-1]
    return section(
        "Particles",
        '<div class="grid">'
        + figure(energy, "The total energy in each pass. The passes end when it no longer falls.")
        + figure(
            count,
            f"Particles are added in sparse regions and removed in crowded ones; {number(last['count'])} remain."
            + _on_junctions(case),
        )
        + "</div>",
    )
