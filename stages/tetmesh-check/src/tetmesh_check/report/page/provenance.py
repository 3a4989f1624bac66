"""How the case was made: inputs, parameters, commands, hashes, and a paragraph to cite."""

from __future__ import annotations

import json
from html import escape

from tetmesh_check.report.page.case import ENDED, Case, dig
from tetmesh_check.report.page.charts import number
from tetmesh_check.report.page.html import amount, section, table

_METHOD = {
    "ftetwild": "fTetWild (Hu et al. 2020)",
    "hxt": "HXT in Gmsh (Marot et al. 2019; Geuzaine and Remacle 2009)",
    "tetgen": "TetGen (Si 2015)",
}


def provenance(case: Case) -> str:
    """Write inputs, what the user set, the commands in order, and each stage's parameters and hashes.

    Parameters
    ----------
    case
        The case.
    """
    given = [
        (escape(str(entry.get("role", ""))), f"<code>{escape(str(entry['path']))}</code>",
         amount(entry["bytes"]) if entry.get("bytes") is not None else "-",
         f'<code class="hash">{escape(str(entry.get("hash") or "-"))}</code>')
        for entry in case.inputs
    ]  # fmt: skip
    body = ""
    if given:
        body += "<h3>Inputs</h3>" + table(("role", "file", "size", "BLAKE3"), given, (0, 1, 3))
    body += "<h3>Parameters</h3>" + (
        table(
            ("variable", "value"),
            [(escape(k), f"<code>{escape(v)}</code>") for k, v in case.parameters.items()],
            (0, 1),
        )
        if case.parameters
        else "<p>None was set; all stages used their defaults.</p>"
    )
    commands = [stage.command for stage in case.stages if stage.command]
    if commands:
        body += f"<h3>Commands</h3><pre>{escape(chr(10).join(commands))}</pre>"
    for stage, report in case.reports.items():
        parameters = [
            (escape(name), escape(json.dumps(value))) for name, value in sorted(report.get("parameters", {}).items())
        ]
        inputs = [
            (escape(entry["path"]), f'<code class="hash">{escape(entry["blake3"])}</code>')
            for entry in report.get("inputs", [])
        ]
        version = escape(str(report.get("version", "")))
        body += (
            f"<details><summary>{escape(stage)} {version}: all parameters used</summary><div>"
            f"<pre>{escape(report['command_line'])}</pre>"
            + table(("parameter", "value"), parameters, (1,))
            + table(("input", "BLAKE3"), inputs, (1,))
            + "</div></details>"
        )
    return section("How this was made", body)


def methods(case: Case) -> str:
    """Write a paragraph about the method with the numbers of this case, to be taken over and cited.

    Parameters
    ----------
    case
        The case.
    """
    reports, results = case.reports, case.results
    ended = {stage.name for stage in case.stages if stage.state in ENDED and stage.error is None}
    if "reconstruct" not in ended or dig(reports, "reconstruct", "results", "check") is None:
        return ""
    version = escape(str(dig(reports, "reconstruct", "version") or ""))
    field, sizes = dig(reports, "distfield", "parameters") or {}, dig(reports, "sizefield", "parameters") or {}
    check = reports["reconstruct"]["results"]["check"]
    what = f"the isosurface at {field['iso']:g}" if isinstance(field.get("iso"), int | float) else "the labelled region"
    if sizes.get("uniform") is not None:
        graded = f"a uniform edge length of {sizes['uniform']:g} mm"
    elif sizes.get("epsilon") is not None and sizes.get("delta") is not None:
        graded = f"edge lengths of {sizes['epsilon']:g} times the local feature size, with a gradient of at most {sizes['delta']:g}"
    else:
        graded = "edge lengths that follow the local feature size"
    text = (
        f"Meshes were made with isoparticles {version}. The volume was turned into a signed distance field of {what}; "
        f"on its zero set particles were distributed with {graded} by a dynamic particle system (Meyer et al. 2005; Kim et al. 2012), "
        f"and the restricted Delaunay triangulation of the particles gave a closed surface of {number(check['vertices'])} vertices and "
        f"{number(check['triangles'])} triangles (mean radius ratio {check['quality']['radius_ratio_mean']:.3f}, minimum "
        f"{check['quality']['radius_ratio_min']:.3f})."
    )
    if (volume := results.get("volume")) is not None:
        method = str(dig(results, "tetrahedralizer", "method"))
        text += (
            f" It was filled with {number(volume['tetrahedra'])} tetrahedra by {_METHOD.get(method, method)}; dihedral angles lie between "
            f"{volume['quality']['min_dihedral']['min']:.1f} and {volume['quality']['max_dihedral']['max']:.1f} degrees."
        )
    if dig(reports, "reconstruct", "parameters", "method") == "tight-cocone":
        text = text.replace(
            "the restricted Delaunay triangulation of the particles", "Tight Cocone (Dey and Goswami 2003)"
        )
    references = (
        "M. Kim, G. Chen, C. Hansen: Dynamic particle system for mesh extraction on the GPU. GPGPU-5, 2012.",
        "M. Meyer, P. Georgel, R. Whitaker: Robust particle systems for curvature dependent sampling of implicit surfaces. SMI 2005.",
    )
    listed = "".join(f"<li>{escape(words)}</li>" for words in references)
    return section("Methods, to cite", f'<p class="cite">{escape(text)}</p><ul class="references">{listed}</ul>')
