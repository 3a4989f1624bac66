//! Better triangles in a complex: the optimiser of one object on each of its sheets, whose borders stay.

use super::interfaces::Interfaces;
use super::nodes::{Nodes, Wall};
use crate::improve::{ImproveOptions, ImproveReport, Sheets, SheetsOf, Step, improve_sheets};
use glam::DVec3;
use isoparticles_field::materials::{Indicators, MaterialId};
use isoparticles_field::spline::Jet;
use isoparticles_stage::error::Result;

/// G of each pair of materials, inside first.
struct Differences<'a> {
    indicators: &'a dyn Indicators,
    pairs: Vec<[MaterialId; 2]>,
}

impl Differences<'_> {
    fn pair(&self, sheet: u32) -> [MaterialId; 2] {
        self.pairs[sheet as usize]
    }
}

impl Sheets for Differences<'_> {
    fn value(&self, sheet: u32, p: DVec3) -> f64 {
        self.value_gradient(sheet, p).0
    }

    fn value_gradient(&self, sheet: u32, p: DVec3) -> (f64, DVec3) {
        let [i, j] = self.pair(sheet);
        self.indicators.difference_gradient(i, j, p)
    }

    fn jet(&self, sheet: u32, p: DVec3) -> Jet {
        let [i, j] = self.pair(sheet);
        self.indicators.difference(i, j, p)
    }

    fn project(&self, sheet: u32, start: DVec3, limit: f64, tolerance: f64) -> Option<(DVec3, DVec3)> {
        let pair = self.pair(sheet);
        let p = self.indicators.project_onto_sheet(pair, start, limit, tolerance)?;
        (self.indicators.clearance(p, &pair) > 0.0).then(|| (p, self.value_gradient(sheet, p).1))
    }

    fn voxel(&self) -> f64 {
        self.indicators.voxel()
    }
}

/// The triangles of interfaces as walls between materials.
pub fn walls(interfaces: &Interfaces) -> Vec<Wall> {
    (0..interfaces.between.len()).map(|t| (interfaces.mesh.corners(t), interfaces.between[t])).collect()
}

/// Improves the triangles of interfaces. Vertices on several sheets, and the first ones in so far as they lie on curves or at points by their `dimensions`,
/// stay; `nodes` are those of the grid where they shall keep their materials. `size` is the target edge length h (mm) at a position.
///
/// # Errors
/// When h is not positive somewhere, and those of `step`.
pub fn improve(
    interfaces: &mut Interfaces,
    dimensions: &[usize],
    indicators: &dyn Indicators,
    nodes: Option<&Nodes>,
    size: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
    step: Step,
) -> Result<ImproveReport> {
    let pairs = interfaces.pairs();
    let number = |pair: &[MaterialId; 2]| pairs.partition_point(|other| other < pair) as u32;
    let of_triangle: Vec<u32> = interfaces.between.iter().map(number).collect();
    let meets = interfaces.materials_at_vertices();
    let mut fixed: Vec<bool> =
        meets.iter().zip(dimensions).map(|(ids, dimension)| ids.len() > 2 || *dimension < 2).collect();
    for (edge, triangles) in interfaces.edges() {
        if triangles.len() != 2 {
            edge.iter().for_each(|&v| fixed[v as usize] = true);
        }
    }
    let junctions = meets.iter().map(|ids| ids.len() > 3).collect();
    let wrong_nodes = nodes.map(|nodes| (nodes.geometry(), nodes.wrong_by_walls(&walls(interfaces))));
    let field = Differences { indicators, pairs };
    let mut sheets = SheetsOf { field: &field, of_triangle, fixed, junctions, wrong_nodes, numbers: Vec::new() };
    let report = improve_sheets(&mut interfaces.mesh, &mut sheets, size, options, step)?;
    let number = |v: u32| sheets.numbers.get(v as usize).copied().unwrap_or(u32::MAX);
    interfaces.segments.iter_mut().for_each(|(pair, _)| *pair = pair.map(number));
    interfaces.joined.iter_mut().for_each(|v| *v = number(*v));
    interfaces.between = sheets.of_triangle.iter().map(|&sheet| field.pair(sheet)).collect();
    Ok(report)
}
