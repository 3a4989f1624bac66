//! A triangle mesh that can be edited: positions, triangles, and the triangles around each vertex.
//! A log records all edits until [`Surface::commit`], so that they can be rolled back.

mod at_nodes;
mod edits;
pub(super) mod measure;

use super::functions::{Freedom, InterfaceFunctions};
use super::grid::TriangleGrid;
use super::nodes::NodeSides;
use crate::interfaces::{Interface, OBJECT};
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::incidence::Incidence;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;
use std::f64::consts::FRAC_PI_3;

/// Corners of a removed triangle.
pub(super) const DEAD: [u32; 3] = [u32::MAX; 3];

/// Target edge length h (mm) at a grid position.
pub(super) type Size<'a> = &'a (dyn Fn(DVec3) -> f64 + Sync);

/// Measured quantities of a triangle at its last commit.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Facts {
    /// Radius ratio, or less if an angle is worse ([`measure::quality_of`]).
    pub(super) quality: f64,
    /// Cosine between the normal and grad F at the centroid.
    pub(super) agreement: f64,
    /// Distance of the centroid from F = 0 in units of the mean target edge length: |F| / |grad F|
    /// or, if this is large, the distance to a point of F = 0 that faces the same way. Near
    /// critical points, |F| / |grad F| is a poor estimate.
    pub(super) deviation: f64,
    /// Minimum and maximum length of a side, in units of the target edge length.
    pub(super) lengths: [f64; 2],
    /// Unit normal.
    pub(super) normal: DVec3,
}

impl Facts {
    /// Facts of a removed triangle. Each quantity has its best value.
    pub(super) const NONE: Self = Self {
        quality: f64::INFINITY,
        agreement: 1.0,
        deviation: 0.0,
        lengths: [f64::INFINITY, 0.0],
        normal: DVec3::ZERO,
    };
}

/// An entry of the log.
#[derive(Clone, Copy, Debug)]
enum Change {
    Moved { vertex: u32, from: DVec3, target: f64 },
    Retriangled { triangle: u32, from: [u32; 3] },
    VertexAdded,
    TriangleAdded,
}

/// The triangles of rings around a triangle, and their vertices, both ascending.
pub(super) struct Rings {
    pub(super) vertices: Vec<u32>,
    pub(super) triangles: Vec<u32>,
}

impl Rings {
    /// Returns the bounding box of the vertices.
    pub(super) fn bounds(&self, surface: &Surface) -> Bounds {
        let positions: Vec<DVec3> = self.vertices.iter().map(|&v| surface.positions[v as usize]).collect();
        Bounds::of(&positions)
    }
}

/// The junction curve at one of its vertices.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Curve {
    /// The two neighbours on the curve.
    pub(super) ends: [u32; 2],
    /// The two or three interfaces that meet on the curve, ascending.
    pub(super) pairs: Vec<Interface>,
}

/// A mesh that can be edited.
#[derive(Clone)]
pub(super) struct Surface<'a> {
    /// The implicit functions of the interfaces.
    pub(super) field: &'a dyn InterfaceFunctions,
    /// Target edge length h (mm) at a grid position.
    pub(super) size: Size<'a>,
    /// Positions of all vertices, including removed ones.
    pub(super) positions: Vec<DVec3>,
    /// Target edge length at each vertex, mm.
    pub(super) target: Vec<f64>,
    /// Triangles; [`DEAD`] if removed.
    pub(super) triangles: Vec<[u32; 3]>,
    /// Interface of each triangle, including removed ones. No edit changes it.
    pub(super) pair: Vec<Interface>,
    /// Triangles around each vertex. They are in ascending order, which does not depend on earlier
    /// edits.
    pub(super) around: Vec<Vec<u32>>,
    /// Whether each vertex is frozen. Frozen vertices do not move, and the triangles at them keep
    /// their corners. These are the vertices inside an interface whose triangles do not form one
    /// closed fan, and in a patch all vertices that must stay.
    pub(super) frozen: Vec<bool>,
    /// How each vertex may move.
    pub(super) freedom: Vec<Freedom>,
    /// Facts of each triangle at its last commit.
    pub(super) facts: Vec<Facts>,
    /// Spatial index of the committed triangles. While it is `None`, commits are not tested for
    /// intersections, and [`Surface::crosses_in_all`] tests all changed triangles at the end.
    pub(super) grid: Option<TriangleGrid>,
    /// An empty grid with the same cells.
    empty: TriangleGrid,
    /// Sides of the grid nodes, if nodes are guarded.
    pub(super) sides: Option<NodeSides<'a>>,
    /// Box that must strictly contain all touched triangles, if this is a part of another surface.
    pub(super) region: Option<Bounds>,
    log: Vec<Change>,
    /// Number of transactions so far, kept or rolled back. This measure of work does not depend on
    /// the number of threads.
    pub(super) tried: usize,
    /// Whether each triangle has changed since the surface was created.
    has_changed: Vec<bool>,
}

impl<'a> Surface<'a> {
    /// Creates the surface of a well-formed mesh of one interface, with a filled grid.
    #[cfg(test)]
    pub(super) fn new(mesh: &TriangleMesh, field: &'a dyn InterfaceFunctions, size: Size<'a>) -> Self {
        let (pair, freedom) = (vec![OBJECT; mesh.triangles.len()], vec![Freedom::Interface; mesh.vertices.len()]);
        let mut new = Self::of_interfaces(mesh, pair, freedom, field, size);
        new.fill_grid();
        new
    }

    /// Creates the surface of a well-formed mesh, given the interface of each triangle and the
    /// freedom of each vertex. A vertex of a curve becomes fixed if [`Self::curve_through`] finds
    /// no curve there. The surface has no grid ([`Self::fill_grid`]).
    pub(super) fn of_interfaces(
        mesh: &TriangleMesh,
        pair: Vec<Interface>,
        freedom: Vec<Freedom>,
        field: &'a dyn InterfaceFunctions,
        size: Size<'a>,
    ) -> Self {
        let incidence = Incidence::new(&mesh.triangles, mesh.vertices.len());
        let around = (0..mesh.vertices.len() as u32).into_par_iter().map(|v| incidence.of(v).to_vec()).collect();
        let mut surface = Self {
            field,
            size,
            positions: mesh.vertices.clone(),
            target: mesh.vertices.par_iter().map(|&p| size(p)).collect(),
            triangles: mesh.triangles.clone(),
            pair,
            frozen: Vec::new(),
            freedom,
            around,
            facts: Vec::new(),
            grid: None,
            empty: TriangleGrid::new(Bounds::of(&mesh.vertices), typical_extent(mesh)),
            sides: None,
            region: None,
            log: Vec::new(),
            tried: 0,
            has_changed: vec![false; mesh.triangles.len()],
        };
        let is_bound = |v: u32| surface.freedom[v as usize] == Freedom::Curve && surface.curve_through(v).is_none();
        let bound: Vec<u32> = (0..mesh.vertices.len() as u32).into_par_iter().filter(|&v| is_bound(v)).collect();
        bound.into_iter().for_each(|v| surface.freedom[v as usize] = Freedom::None);
        let is_open = |v: u32| surface.is_free(v) && !surface.is_closed_fan(v);
        surface.frozen = (0..mesh.vertices.len() as u32).into_par_iter().map(is_open).collect();
        surface.facts = (0..mesh.triangles.len() as u32).into_par_iter().map(|t| surface.measure(t)).collect();
        surface
    }

    /// Creates the grid and fills it with all triangles. All edits must be committed.
    pub(super) fn fill_grid(&mut self) {
        let bounds = |t: u32| if self.is_alive(t) { self.bounds(t) } else { Bounds::EMPTY };
        let boxes = (0..self.triangles.len() as u32).into_par_iter().map(bounds).collect();
        self.grid = Some(self.empty.filled(boxes));
    }

    /// Returns a copy of given triangles (ascending) on given vertices (ascending), with their
    /// facts. The copy has no grid, region or guarded nodes. Vertices with missing triangles are
    /// frozen.
    pub(super) fn part(&self, vertices: &[u32], triangles: &[u32]) -> Self {
        let local = |list: &[u32], item: u32| list.binary_search(&item).ok().map(|n| n as u32);
        let around: Vec<Vec<u32>> = vertices
            .iter()
            .map(|&v| self.around[v as usize].iter().filter_map(|&t| local(triangles, t)).collect())
            .collect();
        let is_frozen =
            |(&v, around): (&u32, &Vec<u32>)| self.frozen[v as usize] || around.len() < self.around[v as usize].len();
        let positions: Vec<DVec3> = vertices.iter().map(|&v| self.positions[v as usize]).collect();
        let corners = |&t: &u32| self.triangles[t as usize].map(|v| local(vertices, v).unwrap_or(u32::MAX));
        Self {
            field: self.field,
            size: self.size,
            grid: None,
            empty: self.empty.emptied(),
            positions,
            target: vertices.iter().map(|&v| self.target[v as usize]).collect(),
            triangles: triangles.iter().map(corners).collect(),
            pair: triangles.iter().map(|&t| self.pair[t as usize]).collect(),
            freedom: vertices.iter().map(|&v| self.freedom[v as usize]).collect(),
            frozen: vertices.iter().zip(&around).map(is_frozen).collect(),
            around,
            facts: triangles.iter().map(|&t| self.facts[t as usize]).collect(),
            sides: None,
            region: None,
            log: Vec::new(),
            tried: 0,
            has_changed: vec![false; triangles.len()],
        }
    }

    /// Returns the mesh without removed vertices and triangles, in the same order.
    #[cfg(test)]
    pub(super) fn into_mesh(self) -> TriangleMesh {
        self.into_parts().0
    }

    /// Returns the mesh without removed vertices and triangles ([`compacted`]).
    pub(super) fn into_parts(self) -> (TriangleMesh, Vec<Interface>, Vec<u32>) {
        compacted(&self.positions, &self.triangles, self.pair)
    }

    /// Returns the positions of the corners of a triangle.
    pub(super) fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Returns the bounding box of a triangle.
    pub(super) fn bounds(&self, triangle: u32) -> Bounds {
        Bounds::of(&self.corners(triangle))
    }

    /// Returns whether a triangle exists, that is, has not been removed.
    pub(super) fn is_alive(&self, triangle: u32) -> bool {
        self.triangles[triangle as usize] != DEAD
    }

    /// Returns the unit normal of the triangle on three vertices.
    pub(super) fn normal_of(&self, corners: [u32; 3]) -> DVec3 {
        let [a, b, c] = corners.map(|v| self.positions[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// Returns the length of an edge, mm.
    pub(super) fn length(&self, a: u32, b: u32) -> f64 {
        self.positions[a as usize].distance(self.positions[b as usize])
    }

    /// Returns a triangle and the `count` rings of triangles around it. `count` is at least 1.
    pub(super) fn rings(&self, triangle: u32, count: usize) -> Rings {
        let mut rings = Rings { vertices: self.triangles[triangle as usize].to_vec(), triangles: Vec::new() };
        for _ in 0..count {
            rings.triangles = rings.vertices.iter().flat_map(|&v| self.around[v as usize].iter().copied()).collect();
            rings.triangles.sort_unstable();
            rings.triangles.dedup();
            rings.vertices = rings.triangles.iter().flat_map(|&t| self.triangles[t as usize]).collect();
            rings.vertices.sort_unstable();
            rings.vertices.dedup();
        }
        rings
    }

    /// Returns the corners of a triangle and of the triangles across its sides.
    pub(super) fn with_neighbours(&self, triangle: u32) -> Vec<[u32; 3]> {
        let corners @ [a, b, c] = self.triangles[triangle as usize];
        let across = |(from, to)| self.edge_triangles(from, to).map(|[_, (t, _)]| self.triangles[t as usize]);
        std::iter::once(corners).chain([(a, b), (b, c), (c, a)].into_iter().filter_map(across)).collect()
    }

    /// Returns the target length of an edge, mm.
    pub(super) fn target_between(&self, a: u32, b: u32) -> f64 {
        0.5 * (self.target[a as usize] + self.target[b as usize])
    }

    /// Returns the length of an edge in units of its target length.
    pub(super) fn relative_length(&self, a: u32, b: u32) -> f64 {
        self.length(a, b) / self.target_between(a, b)
    }

    /// Returns the edges opposite a vertex, oriented so that (vertex, first, second) is a triangle.
    pub(super) fn link(&self, vertex: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.around[vertex as usize].iter().map(move |&t| {
            let c = self.triangles[t as usize];
            let at = c.iter().position(|&v| v == vertex).unwrap_or(0);
            (c[(at + 1) % 3], c[(at + 2) % 3])
        })
    }

    /// Returns the two triangles of an edge with their third corners. The triangle with the edge
    /// from `a` to `b` comes first. Returns `None` unless the edge is in exactly two triangles, of
    /// the same interface and with opposite directions.
    pub(super) fn edge_triangles(&self, a: u32, b: u32) -> Option<[(u32, u32); 2]> {
        let (mut left, mut right) = (None, None);
        for &t in &self.around[a as usize] {
            let c = self.triangles[t as usize];
            for e in 0..3 {
                if c[e] == a && c[(e + 1) % 3] == b {
                    if left.is_some() {
                        return None;
                    }
                    left = Some((t, c[(e + 2) % 3]));
                } else if c[e] == b && c[(e + 1) % 3] == a {
                    if right.is_some() {
                        return None;
                    }
                    right = Some((t, c[(e + 2) % 3]));
                }
            }
        }
        let (left, right) = (left?, right?);
        (self.pair[left.0 as usize] == self.pair[right.0 as usize]).then_some([left, right])
    }

    /// Returns whether two vertices are joined by an edge.
    pub(super) fn joined(&self, a: u32, b: u32) -> bool {
        self.around[a as usize].iter().any(|&t| self.triangles[t as usize].contains(&b))
    }

    /// Returns the number of triangles at a vertex.
    pub(super) fn degree(&self, vertex: u32) -> usize {
        self.around[vertex as usize].len()
    }

    /// Returns the junction curve through a vertex, or `None` if there is none. The triangles of
    /// the vertex must belong to two or three interfaces, and those of each interface must form a
    /// fan from one neighbour on the curve to the other.
    pub(super) fn curve_through(&self, vertex: u32) -> Option<Curve> {
        let fan: Vec<(Interface, u32, u32)> = self.around[vertex as usize]
            .iter()
            .zip(self.link(vertex))
            .map(|(&t, (a, b))| (self.pair[t as usize], a, b))
            .collect();
        let mut pairs: Vec<Interface> = fan.iter().map(|&(pair, ..)| pair).collect();
        pairs.sort_unstable();
        pairs.dedup();
        if !(2..=3).contains(&pairs.len()) {
            return None;
        }
        let mut neighbours: Vec<(u32, Interface)> =
            fan.iter().flat_map(|&(pair, a, b)| [(a, pair), (b, pair)]).collect();
        neighbours.sort_unstable();
        // an edge of the curve has one triangle of each interface
        let of_edges = neighbours.chunk_by(|a, b| a.0 == b.0);
        let mut on_curve =
            of_edges.filter(|own| own.iter().map(|own| own.1).eq(pairs.iter().copied())).map(|own| own[0].0);
        let ends = [on_curve.next()?, on_curve.next()?];
        let is_fan = |&pair: &Interface| {
            let mut left: Vec<(u32, u32)> = fan.iter().filter(|own| own.0 == pair).map(|own| (own.1, own.2)).collect();
            let mut at = ends[0];
            while at != ends[1] {
                let Some(next) = left.iter().position(|&(a, b)| a == at || b == at) else { return false };
                let (a, b) = left.swap_remove(next);
                at = if a == at { b } else { a };
            }
            left.is_empty()
        };
        (on_curve.next().is_none() && pairs.iter().all(is_fan)).then_some(Curve { ends, pairs })
    }

    /// Returns whether a vertex may move on its interface.
    pub(super) fn is_free(&self, vertex: u32) -> bool {
        self.freedom[vertex as usize] == Freedom::Interface
    }

    /// Returns the interface of a free vertex, or 0 if the vertex has no triangles.
    pub(super) fn pair_at(&self, vertex: u32) -> Interface {
        self.around[vertex as usize].first().map_or(OBJECT, |&t| self.pair[t as usize])
    }

    /// Returns whether a vertex has too few triangles to lose one. A vertex that is not free never
    /// has: if an edge inside an interface ends there, at least two triangles of that interface
    /// meet there.
    pub(super) fn has_few(&self, vertex: u32) -> bool {
        self.is_free(vertex) && self.degree(vertex) < 4
    }

    /// Returns whether a triangle keeps its corners and their positions, because all of them are
    /// frozen.
    pub(super) fn is_frozen(&self, triangle: u32) -> bool {
        self.triangles[triangle as usize].iter().all(|&v| v != u32::MAX && self.frozen[v as usize])
    }

    /// Returns whether a corner of a triangle is not free. The quality of such a triangle mostly
    /// depends on the length of a segment of a junction curve, or on the angle between two
    /// segments. Few changes of other triangles improve it.
    pub(super) fn is_held(&self, triangle: u32) -> bool {
        self.triangles[triangle as usize].iter().any(|&v| v != u32::MAX && !self.is_free(v))
    }

    /// Returns whether all corners of a triangle lie on junction curves: no corner is free, and
    /// each also belongs to another interface.
    pub(super) fn is_between_curves(&self, triangle: u32) -> bool {
        let own = self.pair[triangle as usize];
        let is_on_others = |v: u32| self.around[v as usize].iter().any(|&t| self.pair[t as usize] != own);
        self.triangles[triangle as usize].iter().all(|&v| v != u32::MAX && !self.is_free(v) && is_on_others(v))
    }

    /// Returns the number of triangles at a vertex minus six. If the vertex is not free, only the
    /// triangles in the interface of `triangle` count, and their total angle divided by 60 degrees
    /// (rounded, at least 1) replaces six.
    pub(super) fn surplus(&self, vertex: u32, triangle: u32) -> i64 {
        if self.is_free(vertex) {
            return self.degree(vertex) as i64 - 6;
        }
        let pair = self.pair[triangle as usize];
        let own = self.around[vertex as usize].iter().filter(|&&t| self.pair[t as usize] == pair);
        let (mut count, mut angle) = (0, 0.0);
        for &t in own {
            let corners = self.triangles[t as usize];
            let at = corners.iter().position(|&v| v == vertex).unwrap_or(0);
            let [p, q, r] = [0, 1, 2].map(|k| self.positions[corners[(at + k) % 3] as usize]);
            angle += (q - p).angle_between(r - p);
            count += 1;
        }
        count - (angle / FRAC_PI_3).round().max(1.0) as i64
    }

    fn is_closed_fan(&self, vertex: u32) -> bool {
        let link: Vec<(u32, u32)> = self.link(vertex).collect();
        let Some(&(start, mut at)) = link.first() else { return false };
        for step in 1..=link.len() {
            if at == start {
                return step == link.len();
            }
            let mut next = link.iter().filter(|(from, _)| *from == at);
            match (next.next(), next.next()) {
                (Some(&(_, to)), None) => at = to,
                _ => return false,
            }
        }
        false
    }
}

/// Returns the mesh of the triangles that are not [`DEAD`] and of their vertices, in the same
/// order. Also returns the interface of each triangle of the mesh, and the index in the mesh of
/// each vertex (`u32::MAX` if it is not used).
pub(super) fn compacted(
    positions: &[DVec3],
    triangles: &[[u32; 3]],
    mut pair: Vec<Interface>,
) -> (TriangleMesh, Vec<Interface>, Vec<u32>) {
    let alive = || triangles.iter().filter(|corners| **corners != DEAD);
    let mut number = vec![u32::MAX; positions.len()];
    alive().flatten().for_each(|&v| number[v as usize] = 0);
    let mut mesh = TriangleMesh::default();
    for (number, &p) in number.iter_mut().zip(positions).filter(|(number, _)| **number == 0) {
        *number = mesh.vertices.len() as u32;
        mesh.vertices.push(p);
    }
    mesh.triangles = alive().map(|corners| corners.map(|v| number[v as usize])).collect();
    let mut is_alive = triangles.iter().map(|corners| *corners != DEAD);
    pair.retain(|_| is_alive.next() == Some(true));
    (mesh, pair, number)
}

/// Returns the edges of given triangles without duplicates, in ascending order, each with the lower
/// vertex first.
pub(super) fn edges_of<'t>(triangles: impl IntoIterator<Item = &'t [u32; 3]>) -> Vec<(u32, u32)> {
    let sides = triangles.into_iter().flat_map(|&[a, b, c]| [(a, b), (b, c), (c, a)]);
    let mut edges: Vec<(u32, u32)> = sides.map(|(a, b)| (a.min(b), a.max(b))).collect();
    edges.sort_unstable();
    edges.dedup();
    edges
}

fn typical_extent(mesh: &TriangleMesh) -> f64 {
    let mut extents: Vec<f64> = (0..mesh.triangles.len())
        .into_par_iter()
        .map(|t| {
            let b = Bounds::of(&mesh.corners(t));
            (b.high - b.low).max_element()
        })
        .collect();
    let quarter = extents.len() / 4;
    if extents.is_empty() { 1.0 } else { *extents.select_nth_unstable_by(quarter, f64::total_cmp).1 }
}
