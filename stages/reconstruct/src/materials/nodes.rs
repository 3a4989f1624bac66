//! Grid nodes, which are the voxel centres of a label map. Each must lie in the mesh in the
//! material that the indicators give it. Finds the nodes in another material by the crossings of
//! triangles with grid lines, and the points to insert for them.

use super::complex::Complex;
use super::criteria::{Mend, Violation};
use super::prepare::onto;
use crate::interfaces::{Interfaces, segment};
use crate::labelled::Facet;
use crate::queue::{NEAREST_FOR_TOPOLOGY, Reason, Simplex};
use crate::refine::nodes::AT_A_VERTEX;
use glam::DVec3;
use isoparticles_delaunay::INFINITE;
use isoparticles_delaunay::predicates::orientation;
use isoparticles_field::materials::{EulerPair, Indicators, MaterialId, Stratum, euler_pairs};
use isoparticles_mesh::inside::crossings;
use isoparticles_volume::Geometry;
use rayon::prelude::*;
use std::collections::BTreeMap;

/// Maximum distance from a node to the interface that is searched for, in voxels.
const REACH: f64 = 2.0;

/// Distance from an interface, in voxels, below which a node may lie on either side of the mesh.
/// Planes that cut materials can contain nodes, and triangles in such a plane deviate from it by
/// rounding errors. In coordinates of up to 1e4 voxels, these are below 1e4 * 2^-52 = 2e-12 voxel.
const ON_PLANE: f64 = 1e-6;

/// An interface may be in a cell if one of its corners is at most this far from an interface, in
/// diagonals of a cell. The nearest corner is at most half a diagonal away; the margin of 0.1
/// covers the error of distances that are correct to first order. A limit of 1 gives the same Euler
/// characteristics for the tissues of `frog_tissue_labels` and `thorax_labels`.
const NEAR_A_CELL: f64 = 0.6;

/// The material of each grid node.
pub struct Nodes {
    geometry: Geometry,
    /// Material numbers, x fastest.
    material: Vec<u16>,
    /// Nodes within [`ON_PLANE`] of an interface, ascending.
    on_plane: Vec<usize>,
    /// Euler characteristics of the regions.
    pub(super) euler: BTreeMap<MaterialId, EulerPair>,
}

/// A triangle between two materials, with corners in the grid frame.
type Wall = ([DVec3; 3], [MaterialId; 2]);

impl Nodes {
    /// Computes the material of each node of a grid, and the Euler characteristics of the regions,
    /// from the indicators.
    pub fn new(geometry: &Geometry, indicators: &dyn Indicators) -> Self {
        let [nx, ny, nz] = geometry.size;
        let limits = [ON_PLANE * indicators.voxel(), NEAR_A_CELL * geometry.spacing.length()];
        let row = |row: usize| {
            let (j, k) = (row % ny, row / ny);
            (0..nx).map(move |i| {
                let near = indicators.near(geometry.index_to_grid(DVec3::new(i as f64, j as f64, k as f64)));
                let own = indicators.region(near.first().unwrap_or(MaterialId::OUTSIDE));
                (own.0, limits.map(|limit| near.interface_distance() < limit))
            })
        };
        let (material, within): (Vec<u16>, Vec<[bool; 2]>) = (0..ny * nz).into_par_iter().flat_map_iter(row).unzip();
        let on_plane = (0..within.len()).filter(|&node| within[node][0]).collect();
        let euler = euler_pairs(indicators, geometry, &material, &|node| within[node][1]);
        Self { geometry: geometry.clone(), material, on_plane, euler }
    }

    /// Returns the grid.
    pub fn geometry(&self) -> &Geometry {
        &self.geometry
    }

    /// Returns the material number of each node, x fastest.
    pub fn materials(&self) -> &[u16] {
        &self.material
    }

    /// Returns the position of a node (grid frame, mm).
    pub fn place(&self, node: usize) -> DVec3 {
        self.geometry.node_to_grid(node)
    }

    /// Returns the nodes, ascending, that lie in another material of the mesh.
    pub fn wrong_by(&self, interfaces: &Interfaces) -> Vec<usize> {
        let wall = |t: u32| (interfaces.mesh.corners(t as usize), interfaces.regions_of(t));
        self.wrong_by_walls((0..interfaces.between.len() as u32).into_par_iter().map(wall))
    }

    /// Returns the nodes, ascending, that lie in another material according to the given triangles.
    /// Each crossing along a grid line in x removes one material and adds another. A grid line
    /// starts in the outside.
    fn wrong_by_walls(&self, walls: impl ParallelIterator<Item = Wall>) -> Vec<usize> {
        let nx = self.geometry.size[0];
        let mut toggles: Vec<(usize, usize, u16)> = walls
            .flat_map_iter(|(corners, interface)| {
                let mut own = Vec::new();
                crossings(corners, &self.geometry, |at| own.extend(interface.map(|id| (at.row, at.first, id.0))));
                own
            })
            .collect();
        toggles.par_sort_unstable();
        let of_row = |row: usize| {
            let start = toggles.partition_point(|t| t.0 < row);
            let mut toggles = toggles[start..].iter().take_while(move |t| t.0 == row).peekable();
            let mut there = vec![MaterialId::OUTSIDE.0];
            (0..nx).filter(move |&i| {
                while let Some((_, _, id)) = toggles.next_if(|t| t.1 <= i) {
                    match there.iter().position(|known| known == id) {
                        Some(at) => drop(there.swap_remove(at)),
                        None => there.push(*id),
                    }
                }
                // none or several materials if the triangles are not closed
                there != [self.material[row * nx + i]]
            })
        };
        let rows = (0..self.material.len() / nx.max(1)).into_par_iter();
        let wrong = rows.flat_map_iter(|row| of_row(row).map(move |i| row * nx + i));
        wrong.filter(|node| self.on_plane.binary_search(node).is_err()).collect()
    }

    /// Returns the nodes, ascending, that lie in tetrahedra of another material. `facets` are all
    /// facets of the complex.
    pub(super) fn wrong(&self, complex: &Complex, facets: &[Facet]) -> Vec<usize> {
        let wall = |f: &Facet| (f.vertices.map(|v| complex.points()[v as usize]), complex.regions_of(f));
        self.wrong_by_walls(facets.par_iter().map(wall))
    }

    /// Returns the nodes in a tetrahedron or on its faces.
    fn nodes_in(&self, complex: &Complex, tetrahedron: u32) -> Vec<usize> {
        let corners = complex.labelled.delaunay().vertices(tetrahedron).map(|v| complex.points()[v as usize]);
        let (spacing, size) = (self.geometry.spacing, self.geometry.size);
        let (low, high) = corners.iter().fold((corners[0], corners[0]), |(low, high), p| (low.min(*p), high.max(*p)));
        let range = |axis: usize| {
            let last = size[axis] as f64 - 1.0;
            let from = (low[axis] / spacing[axis]).ceil().clamp(0.0, last);
            let to = (high[axis] / spacing[axis]).floor().clamp(0.0, last);
            from as usize..=to as usize
        };
        let is_in = |&node: &usize| {
            (0..4).all(|i| {
                let mut with = corners;
                with[i] = self.place(node);
                orientation(with[0], with[1], with[2], with[3]) >= 0.0
            })
        };
        let rows = range(2).flat_map(|k| range(1).map(move |j| (j, k)));
        let nodes = rows.flat_map(|(j, k)| range(0).map(move |i| (i, j, k)));
        nodes.map(|(i, j, k)| self.geometry.linear(i, j, k)).filter(is_in).collect()
    }

    /// Returns whether a tetrahedron contains a node of its own material.
    pub(super) fn holds_own(&self, complex: &Complex, tetrahedron: u32) -> bool {
        let own = complex.material(tetrahedron).0;
        self.nodes_in(complex, tetrahedron).into_iter().any(|node| self.material[node] == own)
    }

    /// Returns the number of nodes in the given tetrahedra whose material differs from that of the
    /// tetrahedron.
    pub(super) fn wrong_in(&self, complex: &Complex, tetrahedra: &[u32]) -> usize {
        let wrong = |&t: &u32| {
            let own = complex.material(t).0;
            self.nodes_in(complex, t).into_iter().filter(|&node| self.material[node] != own).count()
        };
        tetrahedra.iter().map(wrong).sum()
    }

    /// Returns the violation at a node if it lies in another material. `near` is a vertex near the
    /// node. The remedy is the projection of the node onto the interface of its own material. If
    /// this fails or a vertex is already there, the remedy is a split of a facet nearby.
    pub(super) fn violation(&self, complex: &Complex, node: usize, near: u32) -> Option<Violation> {
        let place = self.place(node);
        let region = MaterialId(self.material[node]);
        let t = complex.labelled.locate(place, near);
        let found = t.map_or(MaterialId::OUTSIDE, |t| complex.material(t));
        if found == region {
            return None;
        }
        let near_node = complex.indicators.near(place);
        let ids = || near_node.entries().iter().map(|(id, _)| *id);
        let own = ids().next().unwrap_or(region);
        let nearest = ids().find(|&id| complex.indicators.region(id) != region);
        let limit = REACH * complex.indicators.voxel();
        let on = |other: MaterialId| {
            let stratum = (other != own).then(|| Stratum::interface(own, other))?;
            Some((onto(complex.indicators, stratum, place, limit)?, stratum))
        };
        let target = nearest.and_then(on).or_else(|| on(found));
        let of = |remedy, radius, size, near| Violation {
            reason: Reason::Node,
            simplex: Simplex::Node(node),
            remedy,
            radius,
            size,
            near,
        };
        let size = complex.sizes[near as usize];
        let vertices_of = |t: Option<u32>| t.map_or(vec![near], |t| complex.labelled.delaunay().vertices(t).to_vec());
        // If no point can be inserted at the projection, a facet near the node is split. In a tube
        // far thinner than h, all facets with the node on the wrong side may be too small. Any
        // other facet is then split.
        let by_split = |vertices: Vec<u32>| {
            let widest = |must_pass_by: bool| {
                let finite = vertices.iter().filter(|&&v| v != INFINITE);
                let splits = finite.filter_map(|&v| self.by_split(complex, node, v, must_pass_by));
                let has_room = |split: &Violation| split.radius >= NEAREST_FOR_TOPOLOGY * split.size;
                splits.filter(has_room).max_by(|a, b| a.radius.total_cmp(&b.radius).then(b.near.cmp(&a.near)))
            };
            widest(true).or_else(|| widest(false))
        };
        let Some((foot, stratum)) = target else {
            return by_split(vertices_of(t)).or_else(|| Some(of(Mend::None, 0.0, size, near)));
        };
        let distance = |v: u32| complex.points().get(v as usize).map_or(f64::INFINITY, |p| p.distance(foot));
        let around = vertices_of(complex.labelled.locate(foot, near)).into_iter().map(|v| (v, distance(v)));
        let (vertex, radius) = around.min_by(|a, b| a.1.total_cmp(&b.1))?;
        let at_foot = of(Mend::Point { place: foot, stratum }, radius, size, near);
        if radius >= AT_A_VERTEX * size {
            return Some(at_foot);
        }
        by_split(vec![vertex]).or_else(|| by_split(vertices_of(t))).or(Some(at_foot))
    }

    /// Returns a violation at a node whose remedy splits a facet at `vertex` in the middle of its
    /// longest edge. The facet with the longest such edge is chosen, only among those with the node
    /// on the wrong side if `must_pass_by` is set.
    fn by_split(&self, complex: &Complex, node: usize, vertex: u32, must_pass_by: bool) -> Option<Violation> {
        let (place, own) = (self.place(node), MaterialId(self.material[node]));
        let passes_by = |f: &Facet| {
            let [a, b, c] = f.vertices.map(|v| complex.points()[v as usize]);
            let outside = (place - a).dot((b - a).cross(c - a)) > 0.0;
            let [i, j] = complex.regions_of(f);
            own == i && outside || own == j && !outside
        };
        let longest = |f: &Facet| {
            let ends = |k: usize| [f.vertices[k], f.vertices[(k + 1) % 3]];
            let length = |[a, b]: [u32; 2]| complex.points()[a as usize].distance(complex.points()[b as usize]);
            let edge = (0..3).map(ends).max_by(|a, b| length(*a).total_cmp(&length(*b)))?;
            Some((length(edge), segment(edge[0], edge[1]), complex.interface(f)))
        };
        let is_meant = |f: &Facet| !must_pass_by || passes_by(f);
        let facets = complex.labelled.facets_at(vertex).into_iter().filter(is_meant).filter_map(|f| longest(&f));
        let (length, edge, [i, j]) = facets.max_by(|a, b| a.0.total_cmp(&b.0).then(b.1.cmp(&a.1)))?;
        let [a, b] = edge.map(|v| complex.points()[v as usize]);
        let size = complex.sizes[vertex as usize];
        let remedy = if complex.segments.curve(edge).is_some() {
            Mend::Split(edge)
        } else {
            let stratum = Stratum::interface(i, j);
            Mend::Point { place: onto(complex.indicators, stratum, a.midpoint(b), 0.5 * length)?, stratum }
        };
        Some(Violation {
            reason: Reason::Node,
            simplex: Simplex::Node(node),
            remedy,
            radius: 0.5 * length,
            size,
            near: vertex,
        })
    }
}

#[cfg(test)]
mod tests {
    use super::super::prepare::prepare;
    use super::super::scenes;
    use super::*;
    use crate::options::Options;

    #[test]
    fn nodes_in_relabelled_tetrahedra_are_wrong() {
        let scene = scenes::sectors();
        let (particles, strata) = scene.particles(1.5, 0.7);
        let prepared = prepare(&particles, &strata, &scene.analytic).expect("on their strata");
        let mut complex = Complex::new(prepared, &scene.analytic, DVec3::splat(scene.extent), &Options::default());
        let nodes = Nodes::new(&scene.geometry(0.7), &scene.analytic);
        let inside: Vec<u32> =
            complex.labelled.facets().iter().map(|f| f.tetrahedron).filter(|&t| nodes.holds_own(&complex, t)).collect();
        assert!(inside.len() > 20, "only {} tetrahedra contain a node", inside.len());
        for t in inside {
            let (own, all) = (complex.material(t), nodes.nodes_in(&complex, t).len());
            assert!(nodes.wrong_in(&complex, &[t]) < all);
            complex.labelled.set(t, MaterialId(9));
            assert_eq!(nodes.wrong_in(&complex, &[t]), all);
            complex.labelled.set(t, own);
        }
    }
}
