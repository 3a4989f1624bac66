"""The parts of the page that show measures: quality, distance, what was solved, and how the particles settled."""

from __future__ import annotations

from html import escape
from typing import Any

from tetmesh_check.page.case import Case
from tetmesh_check.page.charts import curve, histogram, number
from tetmesh_check.page.html import duration, figure, table

_MEASURES = (
    ("radius_ratio", "radius ratio", "1 is regular"),
    ("scaled_jacobian", "scaled Jacobian", "1 is regular"),
    ("min_dihedral", "smallest dihedral angle, degrees", "70.5 is regular"),
    ("max_dihedral", "largest dihedral angle, degrees", "70.5 is regular"),
    ("aspect_ratio", "aspect ratio", "1 is regular"),
    ("edge_ratio", "longest over shortest edge", "1 is regular"),
    ("edge_length", "edge length, mm", ""),
)
_LARGE = 0.1
"""Displacement over the diagonal of the bounding box that linear elasticity no longer describes."""
_PROBLEMS = {
    "poisson": "Poisson's equation, known solution",
    "conduction": "Wave front of excitation in tissue with fibres",
    "elasticity": "Soft organ under its own weight",
}


def _histogram(
    summary: dict[str, Any], title: str, label: str, worst: str, second: bool = False, end: int | None = None
) -> str:
    edges, counts = summary["histogram"]["edges"], summary["histogram"]["counts"][:end]
    beyond = summary["count"] - summary["infinite"] - sum(counts)
    marks = {"mean": summary["mean"], worst: summary["max" if worst == "largest" else "min"]}
    return histogram(edges[: len(counts) + 1], counts, title, label, marks, second, beyond)


def quality(case: Case) -> str:
    """Write histograms and percentiles of quality.

    Parameters
    ----------
    case
        The case.
    """
    if (volume := case.results.get("volume")) is None:
        return ""
    triangles, tetrahedra = case.results["surface"]["quality"], volume["quality"]
    charts = [
        figure(
            _histogram(triangles["radius_ratio"], "Surface triangles", "radius ratio", "smallest"),
            "Twice the inradius over the circumradius, the measure of the paper's Fig. 9: 1 is equilateral.",
        ),
        figure(
            _histogram(tetrahedra["radius_ratio"], "Tetrahedra", "radius ratio", "smallest", True),
            "Three times the inradius over the circumradius: 1 is regular.",
        ),
        figure(
            _histogram(triangles["min_angle"], "Surface triangles", "smallest angle, degrees", "smallest"),
            "The smallest angle of each triangle: 60 degrees is equilateral.",
        ),
        figure(
            _histogram(
                tetrahedra["min_dihedral"], "Tetrahedra", "smallest dihedral angle, degrees", "smallest", True, 24
            ),
            "The smallest angle between two faces of each tetrahedron: 70.5 degrees is regular.",
        ),
    ]
    if "histogram" in (sizes := case.results.get("sizing", {}).get("at_surface", {})):
        charts.append(
            figure(
                _histogram(sizes, "h on the surface", "target edge length, mm", "largest"),
                "The edge length that the size field asks for, at the vertices of the surface.",
            )
        )
    if (over := volume.get("edge_length_over_target")) is not None:
        charts.append(
            figure(
                _histogram(over, "Tetrahedra", "edge length over target", "largest", True),
                "Mean edge of each tetrahedron over what the size field asks for there.",
            )
        )
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
        ("tetrahedra", "smallest", "1 %", "5 %", "median", "95 %", "99 %", "largest", "mean"), rows
    )
    shown = f'<div class="grid">{"".join(charts)}</div>'
    return f"<section><h2>Quality</h2>{shown}{numbers}{_distances(case)}</section>"


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
    kept = "the same triangles, bit for bit" if volume["boundary_kept"] else "other triangles within the envelope"
    return (
        "<h3>Tetrahedra against the surface</h3>"
        + table(("distance, mm", "mean", "99 %", "largest"), rows)
        + f"<p>The boundary of the tetrahedra consists of {kept}; their volume differs by {change:+.2g} % from that inside the surface.</p>"
    )


def _iterations(run: dict[str, Any] | None) -> str:
    return "out of time" if run is None else number(run["iterations"])


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
    large = _LARGE * case.results["surface"]["bounding_box_diagonal_mm"]
    rows = []
    for name, title in _PROBLEMS.items():
        if name not in results or "unknowns" not in results[name] or results[name]["unknowns"] == 0:
            continue
        figures = results[name]
        said = {
            "poisson": lambda f: (
                f"error {100 * f['relative_l2_error']:.2g} % (gradient {100 * f['relative_h1_error']:.2g} %, "
                f"{f['best_approximation']:.2f} times the interpolation's)"
            ),
            "conduction": lambda f: (
                f"potential {f['potential_range_mv'][0]:.1f} to {f['potential_range_mv'][1]:.1f} mV"
            ),
            "elasticity": lambda f: (
                f"largest displacement {number(f['max_displacement_mm'])} mm, energy {number(f['strain_energy_mj'])} mJ"
                + (", beyond the linear theory" if f["max_displacement_mm"] > large else "")
            ),
        }[name](figures)
        condition = (figures["plain"] or {}).get("condition")
        rows.append(
            (
                title,
                number(figures["unknowns"]),
                *(_iterations(figures.get(run)) for run in ("multigrid", "jacobi", "plain")),
                "-" if condition is None else number(float(f"{condition:.2g}")),
                duration(figures["seconds"]),
                said,
            )
        )
    reason = "" if results["reason"] is None else f"<p>Not all was solved: {escape(results['reason'])}.</p>"
    if not rows:
        return f"<section><h2>Solve</h2>{reason}</section>"
    columns = ("problem", "unknowns", "CG, multigrid", "CG, Jacobi", "CG, plain", "condition", "time", "result")
    return (
        "<section><h2>Solve</h2><p>Linear elements and conjugate gradients (CG) to an error of 1e-8 in the energy norm: fewer iterations mean "
        f"an easier time for any solver.</p>{table(columns, rows, (0, 7))}{reason}</section>"
    )


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
    return (
        '<section><h2>Particles</h2><div class="grid">'
        + figure(energy, "The sum of all energies, pass by pass, until it no longer falls.")
        + figure(
            count,
            f"Particles are added where there is room and taken away where it is crowded; {number(last['count'])} at the end.",
        )
        + "</div></section>"
    )
