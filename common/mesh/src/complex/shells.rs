//! The volumes that a complex bounds.
//!
//! Each triangle has two sides, one in each of its materials. The triangles at an edge are sorted
//! by their angle around it. The wedge between two consecutive triangles joins a side of the first
//! to a side of the second. Sides that are connected through wedges are a shell: a closed oriented
//! surface that bounds one connected part of a material from outside, or a cavity in it. Parts that
//! touch only at an edge are separate.

use super::{Complex, OUTSIDE, Side};
use crate::TriangleMesh;
use crate::components::DisjointSets;
use crate::measure::measure_components;
use crate::nesting::enclosing;
use glam::DVec3;
use rayon::prelude::*;

/// The volumes of a complex.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Shells {
    /// Material of each volume, ascending.
    pub materials: Vec<u32>,
    /// Size of each volume without its cavities, mm^3.
    pub sizes: Vec<f64>,
    /// The volumes inside and outside of each triangle. -1 for a shell of a cavity that lies in no
    /// volume of its material. Next to the outside, -1 minus the number of the shell of the
    /// outside.
    pub of_triangle: Vec<[i64; 2]>,
    /// Number of wedges between sides of different materials. At such an edge, the order of the
    /// triangles contradicts their materials.
    pub mixed: usize,
    /// Smallest wedge of each material, in degrees; infinite if it has none.
    pub narrowest: Vec<f64>,
    /// Number of cavities that lie in no volume of their material.
    pub inside_out: usize,
}

/// The space between two consecutive triangles at an edge.
struct Wedge {
    /// The sides of the two triangles, numbered by twice the triangle, plus 1 on its outside.
    sides: [u32; 2],
    /// Degrees, above 0 and at most 360.
    angle: f64,
}

/// The shells, numbered by their first sides.
struct Found {
    /// Shell of each side.
    of_side: Vec<u32>,
    /// Material of each shell.
    materials: Vec<u32>,
    /// The sides of all triangles as triangles that face out of their material.
    facets: TriangleMesh,
    /// Signed volume of each shell.
    sizes: Vec<f64>,
}

impl Complex<'_> {
    /// Finds the volumes. All materials must be closed ([`Complex::open_edges`]), and no two
    /// triangles may intersect.
    pub fn shells(&self) -> Shells {
        let mut shells = Shells { narrowest: vec![f64::INFINITY; self.materials], ..Shells::default() };
        let found = self.find(&mut shells);
        let is_own = |shell: &usize| found.materials[*shell] != OUTSIDE;
        let (mut outer, cavities): (Vec<usize>, Vec<usize>) =
            (0..found.sizes.len()).filter(is_own).partition(|&shell| found.sizes[shell] > 0.0);
        outer.sort_by_key(|&shell| found.materials[shell]);
        let mut volume = vec![-1i64; found.sizes.len()];
        (0..).zip(&outer).for_each(|(n, &shell)| volume[shell] = n);
        for (&cavity, parent) in cavities.iter().zip(self.parents(&found, &cavities)) {
            volume[cavity] = parent.map_or(-1, |shell| volume[shell as usize]);
            shells.inside_out += usize::from(volume[cavity] < 0);
        }
        shells.materials = outer.iter().map(|&shell| found.materials[shell]).collect();
        shells.sizes = vec![0.0; outer.len()];
        for (size, &volume) in found.sizes.iter().zip(&volume) {
            if let Some(sum) = usize::try_from(volume).ok().and_then(|volume| shells.sizes.get_mut(volume)) {
                *sum += size;
            }
        }
        let hollows = (0..found.sizes.len()).filter(|shell| found.materials[*shell] == OUTSIDE);
        (1..).zip(hollows).for_each(|(n, shell)| volume[shell] = -n);
        let volumes = |sides: &[u32; 2]| sides.map(|shell| volume[shell as usize]);
        shells.of_triangle = found.of_side.as_chunks().0.iter().map(volumes).collect();
        shells
    }

    /// Finds the shells, and records the number of mixed wedges and the smallest wedges.
    fn find(&self, shells: &mut Shells) -> Found {
        let of_sides = self.between.as_flattened();
        let mut sets = DisjointSets::new(of_sides.len());
        let edges: Vec<&[Side]> = self.edges().collect();
        for wedge in edges.par_iter().flat_map_iter(|edge| self.wedges(edge)).collect::<Vec<Wedge>>() {
            let [ahead, behind] = wedge.sides;
            sets.join(ahead, behind);
            let material = of_sides[ahead as usize];
            shells.mixed += usize::from(material != of_sides[behind as usize]);
            let narrowest = &mut shells.narrowest[material as usize];
            *narrowest = narrowest.min(wedge.angle);
        }
        let mut of_side: Vec<u32> = Vec::with_capacity(of_sides.len());
        let mut materials = Vec::new();
        for side in 0..of_sides.len() as u32 {
            // the root is the smallest member, so it is either `side` itself or already numbered
            let root = sets.find(side);
            if root == side {
                of_side.push(materials.len() as u32);
                materials.push(of_sides[side as usize]);
            } else {
                of_side.push(of_side[root as usize]);
            }
        }
        let triangles = self.mesh.triangles.iter().flat_map(|&[a, b, c]| [[a, b, c], [a, c, b]]).collect();
        let facets = TriangleMesh { vertices: self.mesh.vertices.clone(), triangles };
        let sizes = measure_components(&facets, &of_side, materials.len());
        Found { of_side, materials, facets, sizes: sizes.into_iter().map(|measure| measure.volume).collect() }
    }

    /// Returns the wedges at an edge.
    fn wedges(&self, edge: &[Side]) -> Vec<Wedge> {
        let [start, end] = edge[0].edge.map(|v| self.mesh.vertices[v as usize]);
        let axis = (end - start).normalize_or_zero();
        // the zero direction is arbitrary, but the same for all triangles of the edge
        let first = axis.any_orthonormal_vector();
        let second = axis.cross(first);
        let angle = |side: &Side| {
            let apex = self.mesh.triangles[side.triangle as usize][usize::from(side.slot + 2) % 3];
            let out = self.mesh.vertices[apex as usize] - start;
            out.dot(second).atan2(out.dot(first)).to_degrees()
        };
        let mut around: Vec<(f64, &Side)> = edge.iter().map(|side| (angle(side), side)).collect();
        around.sort_by(|a, b| a.0.total_cmp(&b.0));
        let wedge = |n: usize| {
            let ((from, before), (to, after)) = (around[n], around[(n + 1) % around.len()]);
            let width = if to > from { to - from } else { to - from + 360.0 };
            // a triangle that traverses the edge forward has its outside ahead, at larger angles
            let (ahead, behind) = (u32::from(before.forward), u32::from(!after.forward));
            Wedge { sides: [2 * before.triangle + ahead, 2 * after.triangle + behind], angle: width }
        };
        (0..around.len()).map(wedge).collect()
    }

    /// Returns, for each cavity, the smallest shell of its material around it.
    fn parents(&self, found: &Found, cavities: &[usize]) -> Vec<Option<u32>> {
        if cavities.is_empty() {
            return Vec::new();
        }
        let mut first: Vec<Option<[u32; 3]>> = vec![None; found.sizes.len()];
        for (&corners, &shell) in found.facets.triangles.iter().zip(&found.of_side) {
            first[shell as usize].get_or_insert(corners);
        }
        // the centroid of a facet of a cavity lies on no other facet of its material
        let centroid =
            |corners: [u32; 3]| corners.map(|v| found.facets.vertices[v as usize]).iter().sum::<DVec3>() / 3.0;
        let starts: Vec<DVec3> = cavities.iter().filter_map(|&cavity| first[cavity].map(centroid)).collect();
        let size = |shell: u32| found.sizes[shell as usize];
        let around = enclosing(&found.facets, &found.of_side, &starts);
        let parent = |(&cavity, around): (&usize, Vec<u32>)| {
            let is_around =
                |shell: &u32| size(*shell) > 0.0 && found.materials[*shell as usize] == found.materials[cavity];
            around.into_iter().filter(is_around).min_by(|&a, &b| size(a).total_cmp(&size(b)))
        };
        cavities.iter().zip(around).map(parent).collect()
    }
}
