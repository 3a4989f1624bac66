//! A copy of the triangles near the vertices that may change, as a separate surface. The time of
//! the edits then depends on the size of the copy, not on that of the mesh.

use super::functions::{Freedom, InterfaceFunctions};
use super::surface::{DEAD, Size, Surface, compacted};
use crate::interfaces::{Interface, Interfaces};
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;

/// Number of rings of vertices that may also change. With 1, 2, 3 and 5 rings, the changed
/// triangles of `heart_label` 1 (20,000 vertices, h = 3.5 instead of 1.86 mm in a ball of 14 mm)
/// reach a mean radius ratio of 0.937, 0.944, 0.951 and 0.951. With a smaller h, one ring is as
/// good as three.
const RIM: usize = 3;

/// Margin of [`Part::region`] around the box of the triangles that may change, in units of the
/// longest side of this box. It leaves room for new vertices.
const MARGIN: f64 = 0.5;

/// The part of a mesh that meets a box.
pub(super) struct Part {
    /// Index in the mesh of each vertex of the part, ascending.
    vertices: Vec<u32>,
    /// Index in the mesh of each triangle of the part, ascending.
    triangles: Vec<u32>,
    /// Whether each vertex of the part may change.
    may_change: Vec<bool>,
    /// The box in which the part may change.
    region: Bounds,
}

impl Part {
    /// Selects the triangles near the vertices that may change: those in `around`, and [`RIM`]
    /// rings of vertices around them.
    pub(super) fn near(mesh: &TriangleMesh, around: &[bool]) -> Self {
        let may_change = with_rings(mesh, around);
        let count = mesh.triangles.len() as u32;
        let bounds = |t: u32| Bounds::of(&mesh.corners(t as usize));
        let changes = |t: &u32| mesh.triangles[*t as usize].iter().any(|&v| may_change[v as usize]);
        let boxes = (0..count).into_par_iter().filter(changes).map(bounds);
        let tight = boxes.reduce(|| Bounds::EMPTY, |all, next| all.merged(next));
        let margin = MARGIN * (tight.high - tight.low).max_element();
        let region = Bounds { low: tight.low - margin, high: tight.high + margin };
        let triangles: Vec<u32> = (0..count).into_par_iter().filter(|&t| region.meets(&bounds(t))).collect();
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| mesh.triangles[t as usize]).collect();
        vertices.par_sort_unstable();
        vertices.dedup();
        let may_change = vertices.iter().map(|&v| may_change[v as usize]).collect();
        Self { vertices, triangles, may_change, region }
    }

    /// Returns the surface of the part. All vertices that may not change are frozen, among them
    /// those with triangles outside the part.
    pub(super) fn surface<'a>(
        &self,
        Interfaces { mesh, between, .. }: &Interfaces,
        freedom: &[Freedom],
        functions: &'a dyn InterfaceFunctions,
        size: Size<'a>,
    ) -> Surface<'a> {
        let local = |v: u32| self.vertices.binary_search(&v).map_or(u32::MAX, |n| n as u32);
        let own = TriangleMesh {
            vertices: self.vertices.iter().map(|&v| mesh.vertices[v as usize]).collect(),
            triangles: self.triangles.par_iter().map(|&t| mesh.triangles[t as usize].map(local)).collect(),
        };
        let between = self.triangles.iter().map(|&t| between[t as usize]).collect();
        let freedom = self.vertices.iter().map(|&v| freedom[v as usize]).collect();
        let mut surface = Surface::of_interfaces(&own, between, freedom, functions, size);
        surface.region = Some(self.region);
        surface.frozen.iter_mut().zip(&self.may_change).for_each(|(frozen, may_change)| *frozen |= !may_change);
        surface
    }

    /// Returns the mesh after the changes of its part, the interface of each triangle, and the
    /// index of each vertex in it, as [`compacted`] does.
    pub(super) fn put_back(
        self,
        surface: Surface,
        mesh: TriangleMesh,
        mut between: Vec<Interface>,
    ) -> (TriangleMesh, Vec<Interface>, Vec<u32>) {
        let TriangleMesh { mut vertices, mut triangles } = mesh;
        let (old, first_added) = (self.vertices.len(), vertices.len() as u32);
        let added = surface.positions.len() - old;
        let number: Vec<u32> = self.vertices.into_iter().chain(first_added..first_added + added as u32).collect();
        number[..old].iter().zip(&surface.positions).for_each(|(&v, &p)| vertices[v as usize] = p);
        vertices.extend_from_slice(&surface.positions[old..]);
        for (t, &corners) in surface.triangles.iter().enumerate() {
            let corners = if corners == DEAD { DEAD } else { corners.map(|v| number[v as usize]) };
            match self.triangles.get(t) {
                Some(&global) => triangles[global as usize] = corners,
                None => {
                    triangles.push(corners);
                    between.push(surface.pair[t]);
                }
            }
        }
        compacted(&vertices, &triangles, between)
    }
}

/// Returns whether each vertex is marked or at most [`RIM`] edges away from a marked vertex.
fn with_rings(mesh: &TriangleMesh, marked: &[bool]) -> Vec<bool> {
    let mut reached = marked.to_vec();
    for _ in 0..RIM {
        let before = reached.clone();
        for corners in mesh.triangles.iter().filter(|corners| corners.iter().any(|&v| before[v as usize])) {
            corners.iter().for_each(|&v| reached[v as usize] = true);
        }
    }
    reached
}

#[cfg(test)]
mod tests {
    use super::super::acceptance::{Goal, Limits, commit_or_rollback};
    use super::super::moves::split;
    use super::super::patch::Patch;
    use super::super::tests::{ball, sampled};
    use super::*;
    use glam::DVec3;
    use isoparticles_field::spline::CubicSpline;
    use isoparticles_mesh::shapes;

    #[test]
    fn edits_of_a_part_change_only_its_triangles() {
        let field = CubicSpline::new(&sampled([17; 3], DVec3::ONE, ball(DVec3::splat(8.2), 6.0)));
        let mut mesh = shapes::icosphere(6.0, 4);
        mesh.vertices.iter_mut().for_each(|p| *p = field.project(8.2 + *p, 0.5, 1e-6).expect("F = 0 is near"));
        let mut around = vec![false; mesh.vertices.len()];
        let centre = mesh.triangles[100][0];
        around[centre as usize] = true;
        let (before, freedom) = (Interfaces::of_object(mesh.clone()), vec![Freedom::Interface; mesh.vertices.len()]);
        let size = |_: DVec3| 0.2;
        for splits in [0, 1] {
            let part = Part::near(&mesh, &around);
            let mut surface = part.surface(&before, &freedom, &field, &size);
            assert!(surface.triangles.len() < mesh.triangles.len() / 8);
            // three rings of six neighbours: 1 + 6 + 12 + 18
            assert_eq!(surface.frozen.iter().filter(|&&frozen| !frozen).count(), 37);
            if splits == 1 {
                let own = part.vertices.binary_search(&centre).expect("it is in the part") as u32;
                let end = surface.link(own).next().expect("an edge").0;
                assert!(split(&mut surface, own, end).is_some());
                assert!(commit_or_rollback(&mut surface, &Limits::LOOSE, Goal::Keep { floor: 0.0 }).is_some());
            }
            let (after, pair, numbers) = part.put_back(surface, mesh.clone(), before.between.clone());
            assert_eq!(after.vertices.len(), mesh.vertices.len() + splits);
            assert_eq!(after.triangles.len(), pair.len());
            assert_eq!(numbers.len(), after.vertices.len());
            assert!(mesh.vertices.iter().zip(&numbers).all(|(p, &v)| after.vertices[v as usize] == *p));
            let kept = mesh.triangles.iter().zip(&after.triangles).filter(|(before, after)| before == after).count();
            assert_eq!(kept, mesh.triangles.len() - 2 * splits);
        }
    }

    #[test]
    fn patches_of_a_part_stay_in_its_box() {
        let field = CubicSpline::new(&sampled([17; 3], DVec3::ONE, ball(DVec3::splat(8.2), 6.0)));
        let mut mesh = shapes::icosphere(6.0, 3);
        mesh.vertices.iter_mut().for_each(|p| *p += 8.2);
        let size = |_: DVec3| 0.5;
        let mut whole = Surface::new(&mesh, &field, &size);
        whole.region = Some(Bounds { low: DVec3::ZERO, high: DVec3::splat(10.0) });
        let patch = Patch::within(&whole, &Bounds { low: DVec3::splat(9.0), high: DVec3::splat(12.0) });
        let both = Bounds { low: DVec3::splat(9.0), high: DVec3::splat(10.0) };
        assert_eq!(patch.surface.region.map(|region| (region.low, region.high)), Some((both.low, both.high)));
    }
}
