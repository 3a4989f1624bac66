//! Improves the triangles of a complex with the optimiser of one object ([`crate::improve`]). Each
//! interface has the function G_ij of its two materials instead of F. Vertices on a junction curve
//! of three materials stay on the curve, and junction points stay fixed.

use super::nodes::Nodes;
use crate::improve::{Freedom, ImproveOptions, ImproveReport, Sheets, SheetsOf, Step, improve_sheets};
use crate::interfaces::{Interfaces, Segment, segment};
use glam::DVec3;
use isoparticles_field::materials::{Indicators, MaterialId, Stratum};
use isoparticles_field::spline::Jet;
use isoparticles_stage::error::Result;
use std::collections::{BTreeMap, BTreeSet};

/// The functions G_ij of the interfaces. Each pair has the material inside first.
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
        let p = self.indicators.project_onto_interface(pair, start, limit, tolerance)?;
        (self.indicators.clearance(p, &pair) > 0.0).then(|| (p, self.value_gradient(sheet, p).1))
    }

    fn project_onto_curve(&self, sheets: [u32; 2], start: DVec3, limit: f64, tolerance: f64) -> Option<DVec3> {
        let [first, second] = sheets.map(|sheet| Stratum::interface(self.pair(sheet)[0], self.pair(sheet)[1]));
        let curve = first.joined(&second)?;
        let own = <[MaterialId; 3]>::try_from(curve.materials()).ok()?;
        let place = self.indicators.project_onto_curve(own, start, limit, tolerance)?;
        (self.indicators.clearance(place, &own) > 0.0).then_some(place)
    }

    fn sides(&self, sheet: u32) -> [u32; 2] {
        self.pair(sheet).map(|id| u32::from(self.indicators.region(id).0))
    }

    fn voxel(&self) -> f64 {
        self.indicators.voxel()
    }
}

/// Returns how each vertex may move, given the dimension of its stratum. A vertex of two materials
/// moves on its interface. A vertex on a curve of three materials moves along it if it has exactly
/// two segments of this curve and is not joined to another stratum. All other vertices are fixed.
fn freedoms(interfaces: &Interfaces, dimensions: &[usize]) -> Vec<Freedom> {
    let meets = interfaces.materials_at_vertices();
    let mut on_sheet: Vec<bool> =
        meets.iter().zip(dimensions).map(|(ids, dimension)| ids.len() == 2 && *dimension == 2).collect();
    for own in interfaces.edges().chunk_by(|a, b| a.0 == b.0).filter(|own| own.len() != 2) {
        own[0].0.iter().for_each(|&v| on_sheet[v as usize] = false);
    }
    let mut at: BTreeMap<u32, Vec<Stratum>> = BTreeMap::new();
    interfaces
        .segments
        .iter()
        .for_each(|(pair, curve)| pair.iter().for_each(|&v| at.entry(v).or_default().push(*curve)));
    let is_inside_curve = |v: usize| {
        let curves = at.get(&(v as u32)).map_or(&[][..], Vec::as_slice);
        matches!(curves, [first, second] if first == second && first.dimension() == 1 && first.materials() == meets[v])
    };
    let joined: BTreeSet<u32> = interfaces.joined.iter().map(|own| own.vertex).collect();
    let freedom = |v: usize| match (on_sheet[v], meets[v].len()) {
        (true, _) => Freedom::Sheet,
        (false, 4..) => Freedom::Point,
        _ if dimensions[v] == 1 && !joined.contains(&(v as u32)) && is_inside_curve(v) => Freedom::Curve,
        _ => Freedom::None,
    };
    (0..meets.len()).map(freedom).collect()
}

/// Returns the segments, ascending, after vertices of curves are removed. The two segments at a
/// removed vertex are replaced by one between its neighbours.
fn bridged(segments: Vec<(Segment, Stratum)>, is_gone: impl Fn(u32) -> bool) -> Vec<(Segment, Stratum)> {
    let (open, mut kept): (Vec<_>, Vec<_>) =
        segments.into_iter().partition(|(pair, _)| pair.iter().any(|&v| is_gone(v)));
    let mut ends: BTreeMap<u32, Vec<(u32, Stratum)>> = BTreeMap::new();
    for &([a, b], curve) in &open {
        for (from, to) in [(a, b), (b, a)] {
            if is_gone(from) {
                ends.entry(from).or_default().push((to, curve));
            }
        }
    }
    while let Some((gone, own)) = ends.pop_first() {
        let [(a, curve), (b, _)] = own[..] else { continue };
        let mut is_whole = true;
        for (end, other) in [(a, b), (b, a)] {
            if let Some(next) = ends.get_mut(&end).and_then(|list| list.iter_mut().find(|(v, _)| *v == gone)) {
                next.0 = other;
                is_whole = false;
            }
        }
        if is_whole {
            kept.push((segment(a, b), curve));
        }
    }
    kept.sort_unstable();
    kept
}

/// Improves the triangles of interfaces. `dimensions` contains the dimension of the stratum of each
/// vertex. Vertices on curves stay on them; junction points and vertices on merged curves are
/// fixed. `nodes` are the grid nodes that must keep their materials. `size` is the target edge
/// length h (mm) at a position. Also returns the index of each vertex in the improved mesh
/// (`u32::MAX` if it was removed).
///
/// # Errors
/// If the mesh is malformed or h is not positive and finite at a vertex; and the errors of `step`.
pub fn improve(
    interfaces: &mut Interfaces,
    dimensions: &[usize],
    indicators: &dyn Indicators,
    nodes: Option<&Nodes>,
    size: &(dyn Fn(DVec3) -> f64 + Sync),
    options: &ImproveOptions,
    step: Step,
) -> Result<(ImproveReport, Vec<u32>)> {
    let pairs = interfaces.pairs();
    let number = |pair: &[MaterialId; 2]| pairs.partition_point(|other| other < pair) as u32;
    let of_triangle: Vec<u32> = interfaces.between.iter().map(number).collect();
    let freedom = freedoms(interfaces, dimensions);
    let is_on_curve: Vec<bool> = freedom.iter().map(|&freedom| freedom == Freedom::Curve).collect();
    let wrong_nodes = nodes.map(|nodes| (nodes.geometry(), nodes.wrong_by(interfaces)));
    let field = Differences { indicators, pairs };
    let mut sheets = SheetsOf { field: &field, of_triangle, freedom, wrong_nodes, numbers: Vec::new() };
    let report = improve_sheets(&mut interfaces.mesh, &mut sheets, size, options, step)?;
    let number = |v: u32| sheets.numbers.get(v as usize).copied().unwrap_or(u32::MAX);
    let is_gone = |v: u32| is_on_curve.get(v as usize) == Some(&true) && number(v) == u32::MAX;
    interfaces.segments = bridged(std::mem::take(&mut interfaces.segments), is_gone);
    interfaces.segments.iter_mut().for_each(|(pair, _)| *pair = pair.map(number));
    interfaces.joined.iter_mut().for_each(|own| own.vertex = number(own.vertex));
    interfaces.between = sheets.of_triangle.iter().map(|&sheet| field.pair(sheet)).collect();
    Ok((report, sheets.numbers))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn removed_vertices_are_bridged_on_their_curve() {
        let [curve, other] = [[0, 1, 2], [0, 1, 3]].map(|ids| Stratum::new(&ids.map(MaterialId)).expect("three"));
        let segments = vec![([0, 4], curve), ([1, 2], other), ([2, 5], curve), ([3, 5], curve), ([4, 5], curve)];
        let left = bridged(segments.clone(), |v| v == 4 || v == 5);
        assert_eq!(left, [([1, 2], other)], "three meet in 5, which cannot go");
        let chain: Vec<_> = segments.into_iter().filter(|(pair, _)| *pair != [3, 5]).collect();
        assert_eq!(bridged(chain.clone(), |v| v == 4 || v == 5), [([0, 2], curve), ([1, 2], other)]);
        assert_eq!(bridged(chain.clone(), |_| false), chain);
    }
}
