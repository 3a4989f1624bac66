//! A closed triangle mesh that can be edited and taken back: positions, triangles, the triangles round each vertex, and a
//! log from which any move can be undone. Nothing is final until [`Surface::commit`].

mod edits;

use super::constants::{FIRST_ORDER, MOST_DEVIATION, POOR, SHORT_SIDE};
use super::grid::TriangleGrid;
use super::guard::quality_of;
use super::moves::projected_facing;
use super::nodes::NodeSides;
use super::patch::Rings;
use super::sheets::{Freedom, Sheets};
use glam::DVec3;
use isoparticles_field::spline::distance_estimate;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::incidence::Incidence;
use isoparticles_mesh::spatial::Bounds;
use rayon::prelude::*;

/// Corners of a triangle that is not there.
pub(super) const DEAD: [u32; 3] = [u32::MAX; 3];

/// Target edge length h (mm) at a grid position.
pub(super) type Size<'a> = &'a (dyn Fn(DVec3) -> f64 + Sync);

/// What is known of a triangle as it was last committed.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Facts {
    /// Radius ratio, or less where its angles are worse ([`quality_of`]).
    pub(super) quality: f64,
    /// Cosine between the normal and grad F at the centroid.
    pub(super) agreement: f64,
    /// Distance of the centroid from F = 0 over the mean target edge length: |F| / |grad F|, or where that is large (near critical points it
    /// says little) the distance to a point of F = 0 that faces the same way.
    pub(super) deviation: f64,
    /// Shortest and longest side over the target edge length.
    pub(super) lengths: [f64; 2],
    /// Unit normal.
    pub(super) normal: DVec3,
}

impl Facts {
    /// Of a triangle that is not there: the best of everything.
    pub(super) const NONE: Self = Self {
        quality: f64::INFINITY,
        agreement: 1.0,
        deviation: 0.0,
        lengths: [f64::INFINITY, 0.0],
        normal: DVec3::ZERO,
    };
}

/// One step of the log.
#[derive(Clone, Copy, Debug)]
enum Change {
    Moved { vertex: u32, from: DVec3, target: f64 },
    Retriangled { triangle: u32, from: [u32; 3] },
    VertexAdded,
    TriangleAdded,
}

/// The mesh under edit.
#[derive(Clone)]
pub(super) struct Surface<'a> {
    /// The implicit functions.
    pub(super) field: &'a dyn Sheets,
    /// Target edge length h (mm) at a grid position.
    pub(super) size: Size<'a>,
    /// Positions, also of vertices no longer used.
    pub(super) positions: Vec<DVec3>,
    /// Target edge length at each vertex, mm.
    pub(super) target: Vec<f64>,
    /// Triangles, [`DEAD`] where one was removed.
    pub(super) triangles: Vec<[u32; 3]>,
    /// The sheet of each triangle, of those removed as well: no edit changes it.
    pub(super) sheet: Vec<u32>,
    /// Triangles round each vertex, ascending, so that nothing depends on what was tried before.
    pub(super) around: Vec<Vec<u32>>,
    /// Vertices whose triangles do not form one closed fan: nothing next to them is touched.
    pub(super) frozen: Vec<bool>,
    /// How each vertex may move.
    pub(super) freedom: Vec<Freedom>,
    /// Facts of each triangle as last committed.
    pub(super) facts: Vec<Facts>,
    /// Committed triangles by place; `None` while commits are not looked at for triangles that cross ([`Surface::crosses_in_all`] does that at the end).
    pub(super) grid: Option<TriangleGrid>,
    /// The grid with nothing in it.
    empty: TriangleGrid,
    /// Guard of the grid nodes, where asked for.
    pub(super) sides: Option<NodeSides<'a>>,
    /// What is changed must lie within, where this is a part of another surface.
    pub(super) region: Option<Bounds>,
    log: Vec<Change>,
    /// Number of transactions so far, kept or taken back. It measures work independently of
    /// threads.
    pub(super) tried: usize,
    commits: u32,
    /// The number of the last commit that changed each triangle.
    changed_at: Vec<u32>,
}

impl<'a> Surface<'a> {
    /// Takes a well-formed mesh of one sheet over.
    #[cfg(test)]
    pub(super) fn new(mesh: &TriangleMesh, field: &'a dyn Sheets, size: Size<'a>) -> Self {
        let (sheet, freedom) = (vec![0; mesh.triangles.len()], vec![Freedom::Sheet; mesh.vertices.len()]);
        let mut new = Self::of_sheets(mesh, sheet, freedom, field, size);
        new.fill_grid();
        new
    }

    /// The same of several sheets, with the sheet of each triangle and how each vertex may move. One that is said to lie on a curve whose triangles
    /// do not end in it, those of each of three sheets by themselves, stays. It has no grid yet ([`Self::fill_grid`]).
    pub(super) fn of_sheets(
        mesh: &TriangleMesh,
        sheet: Vec<u32>,
        freedom: Vec<Freedom>,
        field: &'a dyn Sheets,
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
            sheet,
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
            commits: 0,
            changed_at: vec![0; mesh.triangles.len()],
        };
        let is_bound = |v: u32| surface.freedom[v as usize] == Freedom::Curve && surface.curve_through(v).is_none();
        let bound: Vec<u32> = (0..mesh.vertices.len() as u32).into_par_iter().filter(|&v| is_bound(v)).collect();
        bound.into_iter().for_each(|v| surface.freedom[v as usize] = Freedom::None);
        let is_open = |v: u32| surface.is_free(v) && !surface.is_closed_fan(v);
        surface.frozen = (0..mesh.vertices.len() as u32).into_par_iter().map(is_open).collect();
        surface.facts = (0..mesh.triangles.len() as u32).into_par_iter().map(|t| surface.measure(t)).collect();
        surface
    }

    /// Puts the triangles, all committed, into a new grid.
    pub(super) fn fill_grid(&mut self) {
        let bounds = |t: u32| if self.is_alive(t) { self.bounds(t) } else { Bounds::EMPTY };
        let boxes = (0..self.triangles.len() as u32).into_par_iter().map(bounds).collect();
        self.grid = Some(self.empty.filled(boxes));
    }

    /// A copy of some triangles (ascending) on some vertices (ascending) to try moves on, with the facts of the whole. It has no grid and guards no
    /// nodes until it gets its own; vertices that lack triangles of theirs are frozen.
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
            sheet: triangles.iter().map(|&t| self.sheet[t as usize]).collect(),
            freedom: vertices.iter().map(|&v| self.freedom[v as usize]).collect(),
            frozen: vertices.iter().zip(&around).map(is_frozen).collect(),
            around,
            facts: triangles.iter().map(|&t| self.facts[t as usize]).collect(),
            sides: None,
            region: None,
            log: Vec::new(),
            tried: 0,
            commits: 0,
            changed_at: vec![0; triangles.len()],
        }
    }

    /// The mesh without what was removed; vertices and triangles keep their order.
    #[cfg(test)]
    pub(super) fn into_mesh(self) -> TriangleMesh {
        self.into_sheets().0
    }

    /// The mesh without what was removed, in the same order, the sheet of each of its triangles, and the number that
    /// each vertex has in it, `u32::MAX` where it is gone.
    pub(super) fn into_sheets(self) -> (TriangleMesh, Vec<u32>, Vec<u32>) {
        let mut number = vec![u32::MAX; self.positions.len()];
        let mut mesh = TriangleMesh::default();
        for (v, &p) in self.positions.iter().enumerate() {
            if !self.around[v].is_empty() {
                number[v] = mesh.vertices.len() as u32;
                mesh.vertices.push(p);
            }
        }
        let alive = self.triangles.iter().filter(|t| **t != DEAD);
        mesh.triangles = alive.map(|t| t.map(|v| number[v as usize])).collect();
        let kept = self.triangles.iter().zip(self.sheet).filter(|(t, _)| **t != DEAD);
        (mesh, kept.map(|(_, sheet)| sheet).collect(), number)
    }

    /// Positions of a triangle's corners.
    pub(super) fn corners(&self, triangle: u32) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| self.positions[v as usize])
    }

    /// Box round a triangle.
    pub(super) fn bounds(&self, triangle: u32) -> Bounds {
        Bounds::of(&self.corners(triangle))
    }

    /// Whether a triangle is there.
    pub(super) fn is_alive(&self, triangle: u32) -> bool {
        self.triangles[triangle as usize] != DEAD
    }

    /// Unit normal of the triangle on three vertices.
    pub(super) fn normal_of(&self, corners: [u32; 3]) -> DVec3 {
        let [a, b, c] = corners.map(|v| self.positions[v as usize]);
        (b - a).cross(c - a).normalize_or_zero()
    }

    /// Quality of a triangle as it is now, or as it would be with a side of length h in the place of one that is short and stays ([`Self::side`]), if with that
    /// no triangle as high as it is could pass the check.
    pub(super) fn quality(&self, triangle: u32) -> f64 {
        let corners = self.triangles[triangle as usize];
        let [a, b, c] = corners.map(|v| self.positions[v as usize]);
        let longest = || a.distance(b).max(b.distance(c)).max(c.distance(a));
        for k in 0..3 {
            let (from, to) = (corners[k], corners[(k + 1) % 3]);
            // a third corner may be so near to the side that a better place is nearer still
            if let Some((p, q)) = self.stretched(from, to)
                && 2.0 * self.length(from, to) < POOR * longest()
            {
                return quality_of(p, q, self.positions[corners[(k + 2) % 3] as usize]);
            }
        }
        quality_of(a, b, c)
    }

    /// The ends of a side of length h in the place of one on which no triangle can be good, whatever its third corner: between two junction points far nearer to each other.
    fn stretched(&self, a: u32, b: u32) -> Option<(DVec3, DVec3)> {
        if !self.is_short_side(a, b) {
            return None;
        }
        let (p, q) = (self.positions[a as usize], self.positions[b as usize]);
        let (middle, half) = (p.midpoint(q), 0.5 * self.target_between(a, b) * (q - p).normalize_or_zero());
        Some((middle - half, middle + half))
    }

    /// Whether an edge would lie between two junction points far nearer to each other than h.
    pub(super) fn is_short_side(&self, a: u32, b: u32) -> bool {
        let is_point = |v: u32| self.freedom[v as usize] == Freedom::Point;
        is_point(a) && is_point(b) && self.relative_length(a, b) < SHORT_SIDE
    }

    /// The ends of a side by which a place for the third corner is looked for. Where it is short and stays, it counts as of length h, so that the third corner is drawn to the height of
    /// a good triangle, and not towards the side, where it would spoil the other triangles round it.
    pub(super) fn side(&self, a: u32, b: u32) -> (DVec3, DVec3) {
        self.stretched(a, b).unwrap_or_else(|| (self.positions[a as usize], self.positions[b as usize]))
    }

    /// Length of an edge, mm.
    pub(super) fn length(&self, a: u32, b: u32) -> f64 {
        self.positions[a as usize].distance(self.positions[b as usize])
    }

    /// A triangle and so many rings of triangles round it.
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

    /// Corners of a triangle and of the triangles across its sides.
    pub(super) fn with_neighbours(&self, triangle: u32) -> Vec<[u32; 3]> {
        let corners @ [a, b, c] = self.triangles[triangle as usize];
        let across = |(from, to)| self.edge_triangles(from, to).map(|[_, (t, _)]| self.triangles[t as usize]);
        std::iter::once(corners).chain([(a, b), (b, c), (c, a)].into_iter().filter_map(across)).collect()
    }

    /// Target length of an edge, mm.
    pub(super) fn target_between(&self, a: u32, b: u32) -> f64 {
        0.5 * (self.target[a as usize] + self.target[b as usize])
    }

    /// Length of an edge over its target.
    pub(super) fn relative_length(&self, a: u32, b: u32) -> f64 {
        self.length(a, b) / self.target_between(a, b)
    }

    /// Everything about a triangle as it is now.
    pub(super) fn measure(&self, triangle: u32) -> Facts {
        let corners = self.triangles[triangle as usize];
        if corners == DEAD {
            return Facts::NONE;
        }
        let [a, b, c] = self.corners(triangle);
        let centroid = (a + b + c) / 3.0;
        let sheet = self.sheet[triangle as usize];
        let (value, gradient) = self.field.value_gradient(sheet, centroid);
        let normal = self.normal_of(corners);
        let mean_target = corners.iter().map(|&v| self.target[v as usize]).sum::<f64>() / 3.0;
        let mut deviation = distance_estimate(value, gradient).abs() / mean_target;
        if deviation > FIRST_ORDER
            && let Some(foot) =
                projected_facing(self, sheet, centroid, normal, deviation.min(MOST_DEVIATION) * mean_target)
        {
            deviation = foot.distance(centroid) / mean_target;
        }
        let lengths = [0, 1, 2].map(|e| self.relative_length(corners[e], corners[(e + 1) % 3]));
        Facts {
            quality: self.quality(triangle),
            agreement: normal.dot(gradient.normalize_or_zero()),
            deviation,
            lengths: [lengths[0].min(lengths[1]).min(lengths[2]), lengths[0].max(lengths[1]).max(lengths[2])],
            normal,
        }
    }

    /// The sides opposite a vertex, oriented so that (vertex, first, second) is a triangle.
    pub(super) fn link(&self, vertex: u32) -> impl Iterator<Item = (u32, u32)> + '_ {
        self.around[vertex as usize].iter().map(move |&t| {
            let c = self.triangles[t as usize];
            let at = c.iter().position(|&v| v == vertex).unwrap_or(0);
            (c[(at + 1) % 3], c[(at + 2) % 3])
        })
    }

    /// The two triangles of an edge with their third corners: first the one that runs from `a` to `b`.
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
        Some([left?, right?])
    }

    /// Whether two vertices are joined by an edge.
    pub(super) fn joined(&self, a: u32, b: u32) -> bool {
        self.around[a as usize].iter().any(|&t| self.triangles[t as usize].contains(&b))
    }

    /// Number of triangles (and of edges) at a vertex.
    pub(super) fn degree(&self, vertex: u32) -> usize {
        self.around[vertex as usize].len()
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

/// The edges of some triangles, lower vertex first, in order, each once.
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
