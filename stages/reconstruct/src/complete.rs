//! Improves and checks a mesh: the last steps of a reconstruction and of an update.

use crate::check::{CheckOptions, CheckReport, check};
use crate::improve::{Constraints, Freedom, ImproveOptions, ImproveReport, NodeSides, improve};
use crate::interfaces::{Interfaces, Segment, segment};
use crate::options::Options;
use crate::prepare::PrepareReport;
use crate::refine::RefineReport;
use crate::subject::{Comparison, Subject, Topology};
use crate::tight_cocone::CoconeReport;
use glam::DVec3;
use isoparticles_field::materials::Stratum;
use isoparticles_field::sizing::SizingField;
use isoparticles_mesh::kd_tree::KdTree;
use isoparticles_stage::error::Result;
use isoparticles_stage::monitor::Monitor;
use rayon::prelude::*;
use std::collections::{BTreeMap, BTreeSet};

/// A surface of one object or of many materials, with the results of all steps.
#[derive(Clone, Debug)]
pub struct Reconstruction {
    /// The triangles in the grid frame, with the materials on both sides of each.
    pub interfaces: Interfaces,
    /// Target edge length h at each vertex, mm.
    pub sizes: Vec<f64>,
    /// How the particles were joined; `None` for an updated surface.
    pub joining: Option<Joining>,
    /// Vertices that an update has kept, with their world positions.
    pub kept: Vec<(u32, DVec3)>,
    /// Report of the improvement.
    pub improved: ImproveReport,
    /// Report of the checks.
    pub checked: CheckReport,
    /// Topology of the field and of the mesh.
    pub topology: Topology,
    /// The checks that failed, in words.
    pub failed: Vec<String>,
    /// Warnings that do not fail a check, in words.
    pub doubtful: Vec<String>,
}

/// Reports of the steps that join particles to a surface.
#[derive(Clone, Debug)]
pub struct Joining {
    /// Numbers of particles that were used and not used.
    pub prepared: PrepareReport,
    /// Report of the refinement. With Tight Cocone, the unresolved violations are those of its
    /// surface.
    pub refined: RefineReport,
    /// Report of Tight Cocone, if it is the method.
    pub cocone: Option<CoconeReport>,
    /// Warnings of these steps, in words.
    pub doubtful: Vec<String>,
}

/// Inputs of the last steps, apart from the mesh.
pub(crate) struct Completion<'a> {
    pub(crate) subject: &'a dyn Subject,
    /// Target edge length h (mm) at a position in the grid frame.
    pub(crate) size: &'a (dyn Fn(DVec3) -> f64 + Sync),
    pub(crate) options: &'a Options,
    pub(crate) monitor: &'a dyn Monitor,
}

/// Returns h (mm) as a function of position: that of `sizing` or, without it, that of the nearest
/// of some points.
pub(crate) fn size_at<'a>(
    sizing: Option<&'a SizingField>,
    points: &[DVec3],
    sizes: &'a [f64],
) -> Box<dyn Fn(DVec3) -> f64 + Sync + 'a> {
    let Some(sizing) = sizing else {
        let tree = KdTree::new(points);
        return Box::new(move |p| tree.nearest(p).map_or(f64::NAN, |(v, _)| sizes[v]));
    };
    Box::new(|p| sizing.at(p))
}

impl Completion<'_> {
    /// Improves the triangles of interfaces in the grid frame. Vertices on curves stay on them;
    /// junction points and vertices on merged curves are fixed. `dimensions` contains the dimension
    /// of the stratum of each vertex; it is not used for a single interface. If `around` is given,
    /// the mesh changes only near these vertices. With `adjusts`, the lengths of the edges there
    /// are adjusted to h, also along junction curves. Also returns the index of each vertex in the
    /// improved mesh (`u32::MAX` if it was removed).
    ///
    /// # Errors
    /// Those of [`improve`].
    pub(crate) fn improve(
        &self,
        interfaces: &mut Interfaces,
        dimensions: &[usize],
        around: Option<&[bool]>,
        adjusts: bool,
    ) -> Result<(ImproveReport, Vec<u32>)> {
        let Self { subject, options, .. } = *self;
        let how = ImproveOptions {
            target: options.improve_below,
            relaxation_sweeps: options.relaxation_sweeps,
            // An explicit deviation bound disables thinning. With several interfaces, thinning
            // would change volumes: by 7 % for the nested balls of the tests at the coarse size.
            thins: options.max_deviation.is_none() && interfaces.has_single_interface(),
            around,
            adjusts,
        };
        let mut freedom = freedoms(interfaces, dimensions);
        subject.held(&interfaces.mesh).into_iter().for_each(|v| freedom[v as usize] = Freedom::None);
        let is_on_curve: Vec<bool> = freedom.iter().map(|&freedom| freedom == Freedom::Curve).collect();
        let wrong = if options.keeps_voxels { subject.wrong_nodes(interfaces) } else { None };
        let sides = wrong.map(|wrong| NodeSides::new(subject.geometry(), subject.samples(), wrong));
        let constraints = Constraints { functions: subject.functions(), freedom, sides };
        let (report, numbers) = improve(interfaces, constraints, self.size, &how, &|| Ok(self.monitor.check()?))?;
        let number = |v: u32| numbers.get(v as usize).copied().unwrap_or(u32::MAX);
        if adjusts {
            interfaces.segments = interfaces.edges_of_curves();
        } else {
            let is_gone = |v: u32| is_on_curve.get(v as usize) == Some(&true) && number(v) == u32::MAX;
            interfaces.segments = bridged(std::mem::take(&mut interfaces.segments), is_gone);
            interfaces.segments.iter_mut().for_each(|(pair, _)| *pair = pair.map(number));
        }
        interfaces.joined.iter_mut().for_each(|own| own.vertex = number(own.vertex));
        Ok((report, numbers))
    }

    /// Checks a mesh and compares its topology with that of the field. `joining` and `kept` become
    /// part of the result.
    ///
    /// # Errors
    /// If the run is interrupted.
    pub(crate) fn check(
        &self,
        interfaces: Interfaces,
        improved: ImproveReport,
        joining: Option<Joining>,
        kept: Vec<(u32, DVec3)>,
    ) -> Result<Reconstruction> {
        self.monitor.check()?;
        let _phase = self.monitor.phase("check");
        let options = self.options;
        let how = CheckOptions {
            subject: Some(self.subject),
            keeps_nodes: options.keeps_voxels,
            min_radius_ratio: options.min_radius_ratio,
            max_vertex_distance: Some(options.max_vertex_distance),
            accept_forced: options.accept_forced,
            open_border: options.open_border,
        };
        let checked = check(&interfaces, &how);
        let Comparison { topology, failed, mut doubtful } = self.subject.compare(&interfaces.mesh, &checked);
        let failed = [checked.failed.clone(), failed].concat();
        doubtful.extend(joining.iter().flat_map(|joining| joining.doubtful.clone()));
        let sizes = interfaces.mesh.vertices.par_iter().map(|&p| (self.size)(p)).collect();
        Ok(Reconstruction { interfaces, sizes, joining, kept, improved, checked, topology, failed, doubtful })
    }
}

/// Returns how each vertex may move, given the dimension of its stratum. A vertex of dimension 2
/// moves on its interface if each of its edges has two triangles. A vertex on a curve of three
/// materials moves along it if it has exactly two segments of this curve and is not joined to
/// another stratum. All other vertices are fixed.
fn freedoms(interfaces: &Interfaces, dimensions: &[usize]) -> Vec<Freedom> {
    if interfaces.has_single_interface() {
        return vec![Freedom::Interface; interfaces.mesh.vertices.len()];
    }
    let meets = interfaces.materials_at_vertices();
    let mut on_interface: Vec<bool> =
        meets.iter().zip(dimensions).map(|(ids, dimension)| ids.len() == 2 && *dimension == 2).collect();
    for own in interfaces.edges().chunk_by(|a, b| a.0 == b.0).filter(|own| own.len() != 2) {
        own[0].0.iter().for_each(|&v| on_interface[v as usize] = false);
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
    let freedom = |v: usize| match (on_interface[v], meets[v].len()) {
        (true, _) => Freedom::Interface,
        (false, 4..) => Freedom::Point,
        _ if dimensions[v] == 1 && !joined.contains(&(v as u32)) && is_inside_curve(v) => Freedom::Curve,
        _ => Freedom::None,
    };
    (0..meets.len()).map(freedom).collect()
}

/// Returns the segments, ascending, after vertices of curves are removed. Two segments at a
/// removed vertex become one between its neighbours; other numbers of segments are dropped.
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

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::materials::MaterialId;

    #[test]
    fn removed_vertices_are_bridged_on_their_curve() {
        let [curve, other] = [[0, 1, 2], [0, 1, 3]].map(|ids| Stratum::new(&ids.map(MaterialId)).expect("three"));
        let segments = vec![([0, 4], curve), ([1, 2], other), ([2, 5], curve), ([3, 5], curve), ([4, 5], curve)];
        let left = bridged(segments.clone(), |v| v == 4 || v == 5);
        assert_eq!(left, [([1, 2], other)], "the three segments at 5 are dropped");
        let chain: Vec<_> = segments.into_iter().filter(|(pair, _)| *pair != [3, 5]).collect();
        assert_eq!(bridged(chain.clone(), |v| v == 4 || v == 5), [([0, 2], curve), ([1, 2], other)]);
        assert_eq!(bridged(chain.clone(), |_| false), chain);
    }
}
