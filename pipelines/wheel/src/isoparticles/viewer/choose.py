"""Chooses the object of a volume that has no mesh: a preview, a predicted cost, and the run."""

from __future__ import annotations

import asyncio
import json
import re
import subprocess
from typing import Any

import numpy as np
import pyvista as pv

import isoparticles.viewer.case as cases
from isoparticles._errors import Error
from isoparticles.viewer.control import Control
from isoparticles.viewer.run import StagesJob, info_command, stages_command
from isoparticles.viewer.scene import PLAIN
from tetmesh_check.report.page.scan import Scan
from tetmesh_check.report.page.templates import duration, memory

PREVIEW = 80
"""Maximum number of voxels of the preview along an axis. Extracting its surface takes 0.05 s."""
SETTLED = 0.3
"""Seconds without a change after which the cost is predicted."""


class Choice:
    """The panel "Object" of the page."""

    def __init__(self, control: Control) -> None:
        self.control, self.state = control, control.state
        scan = control.shown.scan
        self.scan = scan
        self._coarse = None if scan is None else coarsened(scan)
        self._asked = 0
        self._info: dict[str, Any] | None = None
        self.state.update({
            "labels": [], "labels_chosen": [], "as_materials": False, "iso": 0.0, "inside": "above",
            "vertices_log": 4.3, "vertices": 20_000, "is_default_size": True,
            "prediction": {"vertices": "", "seconds": "", "memory": "", "note": ""},
        })  # fmt: skip
        if scan is None or control.shown.mesh is not None:
            return
        if scan.labels:
            self._list_labels(scan)
        else:
            low, high = self.state.levels
            self.state.iso = float(f"{low + 0.5 * (high - low):.4g}")
        control.server.trigger("make")(control._safely(self.make))
        self.state.change("iso", "inside", "labels_chosen")(lambda **_: self.changed())
        self.state.change("vertices_log", "is_default_size")(lambda **_: self.show_prediction())
        self.preview()

    def _list_labels(self, scan: Scan) -> None:
        values, counts = (part.tolist() for part in np.unique(scan.values, return_counts=True))
        entries = {label: entry for entry in self.control.shown.key for label in entry.labels}
        self.state.labels = [
            {"label": v, "name": entries[v].name, "colour": f"#{bytes(entries[v].colour).hex()}", "voxels": f"{n:,}"}
            for v, n in zip(values, counts, strict=True)
            if v in entries
        ]
        self.state.labels_chosen = [one["label"] for one in self.state.labels]

    @property
    def settings(self) -> dict[str, str]:
        """The settings of the case that the panel describes.

        Raises
        ------
        Error
            If no label is ticked, or if the iso value is not a number.
        """
        state, found = self.state, {"INPUT": str(self.control.shown.volume), "NAME": self.control.shown.name}
        if state.is_scan:
            if not isinstance(state.iso, (int, float)):
                raise Error("The iso value is not a number", "it separates the object from the rest", "give a number")
            found |= {"ISO": f"{state.iso:g}", "INSIDE": str(state.inside)}
        else:
            labels = sorted(int(label) for label in state.labels_chosen)
            if not labels:
                raise Error("No label is ticked", "the surface encloses the ticked labels", "tick a label")
            key = "MATERIALS" if state.as_materials and len(labels) > 1 else "LABELS"
            # a name must not contain the separators of MATERIALS
            names = {one["label"]: re.sub(r"[^\w-]+", "_", one["name"]) for one in state.labels}
            words = [f"{names[label]}:{label}" if key == "MATERIALS" else str(label) for label in labels]
            found[key] = ",".join(words)
        if not state.is_default_size:
            found["VERTICES"] = str(int(state.vertices))
        return found

    def changed(self) -> None:
        """Update the preview, and predict the cost after ``SETTLED`` seconds without a change."""
        self.preview()
        self._asked += 1
        asyncio.get_running_loop().create_task(self._predict(self._asked))

    def preview(self) -> None:
        """Show the surface of the object in a coarser volume."""
        if self._coarse is None or self.state.has_mesh:
            return
        scene, scan = self.control.scene, self._coarse
        if scan.labels:
            entries = {label: entry for entry in self.control.shown.key for label in entry.labels}
            chosen = [int(label) for label in self.state.labels_chosen]
            shown = [(isosurface(scan, scan.values == label, 0.5), entries[label].colour) for label in chosen]
            scene.show_preview([(surface, tuple(colour)) for surface, colour in shown])
            whole = isosurface(scan, np.isin(scan.values, chosen), 0.5)
        elif isinstance(self.state.iso, (int, float)):
            whole = isosurface(scan, scan.values, float(self.state.iso))
            scene.show_preview([(whole, PLAIN)])
        else:
            return
        if self.control.slices is not None:
            self.control.slices.show_surface(whole if whole.n_cells else None)
        self.control.draw_slices(images=False)
        self.control.refresh_view()

    async def _predict(self, asked: int) -> None:
        """Run ``info`` for the object, unless another change has followed in the meantime."""
        await asyncio.sleep(SETTLED)
        if asked != self._asked:
            return
        try:
            info, note = await asyncio.to_thread(predicted, self.settings)
        except Error as error:
            info, note = None, f"{error.what}."
        if asked != self._asked:
            return
        with self.state:
            self._info = info
            self.state.prediction = {**self.state.prediction, "note": note}
            self.show_prediction()

    def show_prediction(self) -> None:
        """Show the predicted cost of the chosen number of vertices."""
        state, cost = self.state, self._info
        if cost is not None and state.is_default_size:
            state.vertices_log = float(np.log10(max(cost["vertices"], 500)))
        state.vertices = int(float(f"{10 ** float(state.vertices_log):.2g}"))
        found = {"vertices": "", "seconds": "", "memory": ""}
        if cost is not None:
            seconds, size = scaled(cost, int(state.vertices))
            texts = (f"{int(state.vertices):,}", duration(seconds), memory(size))
            found = {key: f"about {text}" for key, text in zip(found, texts, strict=True)}
        state.prediction = {**state.prediction, **found}

    def make(self) -> None:
        """Run the stages."""
        control = self.control
        control._expect_idle()
        control.lock()
        job = StagesJob(stages_command(self.settings, control.shown.out))
        control.begin(job, self._made)
        job.run()

    def _made(self) -> None:
        """Show the results of the run."""
        control = self.control
        assert control.shown.folder is not None
        status = control.shown.folder / f"{control.shown.name}.status.json"
        control.shown = cases.open_results(status)
        control.open()
        control.look_at_all()


def predicted(settings: dict[str, str]) -> tuple[dict[str, Any] | None, str]:
    """Return the cost of the surface for the default sizes, or None and the reason."""
    done = subprocess.run(info_command(settings), capture_output=True, text=True, check=False)
    try:
        cost = json.loads(done.stdout)["objects"][0]["cost"]
    except (ValueError, KeyError, IndexError):
        return None, (done.stderr.strip().splitlines() or ["The cost cannot be predicted."])[0]
    return cost, "" if cost else "The object contains no voxel."


def coarsened(scan: Scan) -> Scan:
    """Return every n-th voxel along each axis, so that no axis has more than ``PREVIEW`` voxels."""
    stride = max(1, -(-max(scan.values.shape) // PREVIEW))
    values = scan.values[::stride, ::stride, ::stride]
    return Scan(values, scan.step * stride, scan.origin, scan.anatomical, scan.names, 1, scan.labels)


def isosurface(scan: Scan, values: Any, level: float) -> pv.PolyData:
    """Return the isosurface around the values above a level, closed at the border of the volume."""
    low = min(float(np.min(values)), level) - 1.0
    image = pv.ImageData(dimensions=np.array(values.shape) + 2, spacing=tuple(scan.spacing))
    image.origin = tuple(scan.origin - scan.step.sum(axis=1))
    image.direction_matrix = scan.step / scan.spacing
    padded = np.pad(np.nan_to_num(values.astype(np.float32), nan=low), 1, constant_values=low)
    surface: Any = image.contour([level], scalars=padded.flatten(order="F"), method="flying_edges")
    triangles: pv.PolyData = surface.triangulate()
    return triangles


def scaled(cost: dict[str, Any], vertices: int) -> tuple[float, float]:
    """Return processor time and memory of the surface for a number of vertices.

    ``info`` predicts the cost for the default sizes. The time of the stages after the fields is
    scaled by the number of vertices. Each further vertex adds memory; fewer vertices do not reduce
    the estimate.
    """
    share = vertices / max(cost["vertices"], 1)
    stages = {stage["stage"]: stage for stage in cost["stages"] if stage["stage"] != "tetrahedra"}
    seconds = sum(stage["seconds"] * (1.0 if name == "fields" else share) for name, stage in stages.items())
    further = max(vertices - cost["vertices"], 0)
    return seconds, max(stage["bytes"] + stage["bytes_per_vertex"] * further for stage in stages.values())
