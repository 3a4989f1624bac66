//! Marching cubes (Lorensen and Cline 1987): computes a closed, manifold triangulation of F = iso.
//! The stages use it for seeds, components and dense samples of the surface.
//!
//! The case table is computed at run time. If exactly two corners of a cell face are inside and
//! they are diagonally opposite, the sign at the saddle of the face decides whether they are joined
//! (Nielson and Hamann 1991). The saddle value is computed with a quadratic interpolant, because
//! the bilinear interpolant breaks up diagonal layers that are one voxel thick. Two cells that
//! share a face always create the same segments on it. The segments form loops, and each loop is
//! triangulated without diagonals on cell faces. Every edge therefore lies in exactly two
//! triangles.

use crate::node_bits::{NodeBits, Side, WORD, each_bit, first_bits, shifted};
use glam::DVec3;
use isoparticles_mesh::TriangleMesh;
use isoparticles_mesh::buckets::{joined, starts_of};
use isoparticles_volume::Image;
use rayon::prelude::*;
use std::collections::BTreeSet;
use std::sync::OnceLock;

/// Minimum distance of a vertex from the nodes of its grid edge, as a fraction of the edge length.
/// It prevents degenerate triangles where a sample equals the iso value. The distance remains
/// positive after rounding to single precision: at index 512, an ulp of f32 is 6e-5.
pub(crate) const NODE_CLEARANCE: f64 = 1e-3;

/// Number of slices of cells per parallel task. Each task also numbers the vertices of the slice
/// after its last one, which adds an eighth to the cost of numbering.
const SLICES_PER_TASK: usize = 8;

/// Returns the surface that separates the samples below `iso` (inside) from all other samples, in
/// the grid frame (mm).
///
/// Triangles are counter-clockwise when seen from the side of the larger values. Values equal to
/// `iso` and NaNs count as outside. The mesh is closed, except where inside samples lie on the
/// border of the image. Its edges and vertices are manifold. The order of vertices and triangles
/// does not depend on the number of threads.
pub fn marching_cubes(image: &Image<f32>, iso: f32) -> TriangleMesh {
    let [nx, ny, nz] = image.geometry.size;
    if nx < 2 || ny < 2 || nz < 2 {
        return TriangleMesh::default();
    }
    let grid = Grid { image, iso, inside: NodeBits::of(&image.data, nx, Side::Below, iso) };
    let slices: Vec<Vec<DVec3>> = (0..nz).into_par_iter().map(|k| grid.slice_vertices(k)).collect();
    let offsets = starts_of(slices.iter().map(Vec::len));
    let mut vertices = joined(slices);
    let total = vertices.len() as u32;

    let cells: Vec<usize> = (0..nz - 1).collect();
    let mut parts: Vec<Part> =
        cells.par_chunks(SLICES_PER_TASK).map(|chunk| grid.triangulate(chunk, &offsets, total, &vertices)).collect();
    let centres_before = starts_of(parts.iter().map(|part| part.centres.len()));
    parts.par_iter_mut().zip(centres_before).for_each(|(part, before)| {
        let shifted = |v: u32| if v < total { v } else { v + before };
        part.triangles.iter_mut().for_each(|t| *t = t.map(shifted));
    });
    let (triangles, centres): (Vec<_>, Vec<_>) = parts.into_iter().map(|part| (part.triangles, part.centres)).unzip();
    vertices.extend(centres.into_iter().flatten());
    let triangles = joined(triangles);
    TriangleMesh { vertices, triangles }
}

struct Grid<'a> {
    image: &'a Image<f32>,
    iso: f32,
    /// Bit mask of the nodes that are inside. Most 64-bit words contain no crossing and are
    /// skipped.
    inside: NodeBits,
}

/// The triangles that one task creates. Vertex indices at or above the total number of edge
/// vertices refer to `centres`.
#[derive(Default)]
struct Part {
    triangles: Vec<[u32; 3]>,
    centres: Vec<DVec3>,
}

/// Indices of the vertices on the three grid edges that start at each node of a slice, x fastest.
/// Entries for edges without a crossing are arbitrary.
struct SliceNumbers {
    on_edge: Vec<[u32; 3]>,
}

impl Grid<'_> {
    /// Calls `visit(i, j, axis)` for each crossed grid edge that starts in slice `k`, in the order
    /// of the vertex indices.
    fn each_crossing(&self, k: usize, mut visit: impl FnMut(usize, usize, usize)) {
        let [nx, ny, nz] = self.image.geometry.size;
        for j in 0..ny {
            let row = k * ny + j;
            let own = self.inside.row(row);
            let along_y = if j + 1 < ny { self.inside.row(row + 1) } else { own };
            let along_z = if k + 1 < nz { self.inside.row(row + ny) } else { own };
            for word in 0..own.len() {
                let (at, next) = (own[word], shifted(own, word, 1));
                let first = word * WORD;
                let crossed = [(at ^ next) & first_bits(nx - 1 - first), at ^ along_y[word], at ^ along_z[word]];
                each_bit(crossed[0] | crossed[1] | crossed[2], |bit| {
                    (0..3).filter(|&axis| crossed[axis] >> bit & 1 == 1).for_each(|axis| visit(first + bit, j, axis));
                });
            }
        }
    }

    fn slice_vertices(&self, k: usize) -> Vec<DVec3> {
        let [nx, ny, _] = self.image.geometry.size;
        let mut vertices = Vec::new();
        self.each_crossing(k, |i, j, axis| {
            let at = (k * ny + j) * nx + i;
            let [a, b] = [at, at + [1, nx, nx * ny][axis]].map(|n| self.image.data[n]);
            let t = (f64::from(self.iso) - f64::from(a)) / (f64::from(b) - f64::from(a));
            let t = if t.is_finite() { t.clamp(NODE_CLEARANCE, 1.0 - NODE_CLEARANCE) } else { 0.5 };
            let index = DVec3::new(i as f64, j as f64, k as f64) + DVec3::AXES[axis] * t;
            vertices.push(self.image.geometry.index_to_grid(index));
        });
        vertices
    }

    /// Numbers the vertices of slice `k`, starting at `offset`. Entries for edges without a
    /// crossing are left unchanged.
    fn number(&self, k: usize, offset: u32, numbers: &mut SliceNumbers) {
        let nx = self.image.geometry.size[0];
        let mut next = offset;
        self.each_crossing(k, |i, j, axis| {
            numbers.on_edge[j * nx + i][axis] = next;
            next += 1;
        });
    }

    fn triangulate(&self, slices: &[usize], offsets: &[u32], total: u32, vertices: &[DVec3]) -> Part {
        let [nx, ny, _] = self.image.geometry.size;
        let table = table();
        let mut part = Part::default();
        let [mut lower, mut upper] = [0, 1].map(|_| SliceNumbers { on_edge: vec![[0; 3]; nx * ny] });
        self.number(slices[0], offsets[slices[0]], &mut lower);
        for &k in slices {
            self.number(k + 1, offsets[k + 1], &mut upper);
            for (j, word) in (0..ny - 1).flat_map(|j| (0..self.inside.width()).map(move |word| (j, word))) {
                // the four rows of nodes, y fastest, in the order of the corners of a cell
                let rows = [0, 1, ny, ny + 1].map(|n| {
                    let row = self.inside.row(k * ny + j + n);
                    (row[word], shifted(row, word, 1))
                });
                let any = rows.iter().fold(0, |all, (at, next)| all | at | next);
                let every = rows.iter().fold(u64::MAX, |all, (at, next)| all & at & next);
                each_bit(any & !every & first_bits(nx - 1 - word * WORD), |bit| {
                    let i = word * WORD + bit;
                    let corner = |n: usize, bits: u64| (bits >> bit & 1) << n;
                    let case: u64 = (0..4).map(|n| corner(n, rows[n].0) | corner(n + 4, rows[n].1)).sum();
                    let number = |e: u8| {
                        let edge = EDGES[usize::from(e)];
                        let [di, dj, dk] = offset(edge.corner);
                        let slice = if dk == 0 { &lower } else { &upper };
                        slice.on_edge[(j + dj) * nx + i + di][edge.axis]
                    };
                    let case = &table[case as usize];
                    let variant = self.joined_faces(&case.ambiguous, (k * ny + j) * nx + i);
                    for piece in &case.variants[variant] {
                        match piece {
                            Piece::Triangles(list) => {
                                part.triangles.extend(list.iter().map(|t| t.map(number)));
                            }
                            Piece::Fan(cycle) => {
                                let centre = total + part.centres.len() as u32;
                                let sum: DVec3 = cycle.iter().map(|&e| vertices[number(e) as usize]).sum();
                                part.centres.push(sum / cycle.len() as f64);
                                for (n, &e) in cycle.iter().enumerate() {
                                    let next = cycle[(n + 1) % cycle.len()];
                                    part.triangles.push([centre, number(e), number(next)]);
                                }
                            }
                        }
                    }
                });
            }
            std::mem::swap(&mut lower, &mut upper);
        }
        part
    }

    /// Returns one bit for each ambiguous face of the cell whose lowest node is `base`. The bit is
    /// set if the inside corners of the face are joined.
    fn joined_faces(&self, ambiguous: &[[u8; 4]], base: usize) -> usize {
        let [nx, ny, _] = self.image.geometry.size;
        let node = |corner: u8| {
            let [di, dj, dk] = offset(corner);
            base + (dk * ny + dj) * nx + di
        };
        let joined = ambiguous.iter().enumerate().map(|(n, &face)| {
            let [a, b, c, d] = face.map(node);
            usize::from(saddle_value(self.image, [a, c], [b, d]) < f64::from(self.iso)) << n
        });
        joined.sum()
    }
}

/// Returns the value at the saddle of a cell face, given its two pairs of diagonally opposite
/// nodes. The value of the bilinear interpolant is corrected with the mean second differences along
/// the two axes. Second differences across the image border count as zero. If the saddle value is
/// below the iso value, the inside corners are joined across the face.
pub fn saddle_value(image: &Image<f32>, diagonal: [usize; 2], other: [usize; 2]) -> f64 {
    // sorted, so that both cells that share the face compute the same bits
    let mut nodes = [diagonal[0], diagonal[1], other[0], other[1]];
    nodes.sort_unstable();
    let [a, b, c, d] = nodes.map(|n| f64::from(image.data[n]));
    let twist = a + d - b - c;
    let (u, v) = ((a - c) / twist, (a - b) / twist);
    let bilinear = (a * d - b * c) / twist;
    let [along_u, along_v] = [nodes[1], nodes[2]].map(|next| {
        let bends = nodes.map(|n| second_difference(image, n, next - nodes[0]));
        0.25 * bends.iter().sum::<f64>()
    });
    bilinear - 4.0 * MIDPOINT_BEND * (u * (1.0 - u) * along_u + v * (1.0 - v) * along_v)
}

/// Factor of the second-order correction of the value at the midpoint of two nodes: the value is
/// their mean minus this factor times the mean of their second differences. With 0.2, each of the
/// two nodes has the weight 0.6, as in the cubic spline. The next node on either side has the
/// weight -0.1, compared with -0.13 in the spline.
pub const MIDPOINT_BEND: f64 = 0.2;

/// Returns the second difference at a node along the axis with the given stride. It is zero on the
/// image border.
fn second_difference(image: &Image<f32>, node: usize, stride: usize) -> f64 {
    let [nx, ny, nz] = image.geometry.size;
    let (step, count) =
        [(nx * ny, nz), (nx, ny), (1, nx)].into_iter().find(|(step, _)| stride >= *step).unwrap_or((1, nx));
    let at = node / step % count;
    if at == 0 || at + 1 == count {
        return 0.0;
    }
    let value = |n: usize| f64::from(image.data[n]);
    value(node - step) + value(node + step) - 2.0 * value(node)
}

// ---- the case table ----------------------------------------------------------------------------

/// For each axis, the bit of a corner number that gives the offset of the corner along that axis.
/// The four corners with the same x have consecutive numbers.
const AXIS_BIT: [u8; 3] = [4, 1, 2];

/// Returns the offset of a corner along each axis, 0 or 1.
fn offset(corner: u8) -> [usize; 3] {
    AXIS_BIT.map(|bit| usize::from(corner & bit != 0))
}

/// An edge of the cell, given by its lower corner and its direction.
#[derive(Clone, Copy)]
struct Edge {
    corner: u8,
    axis: usize,
}

const EDGES: [Edge; 12] = edges();

const fn edges() -> [Edge; 12] {
    let mut list = [Edge { corner: 0, axis: 0 }; 12];
    let (mut axis, mut n) = (0, 0);
    while axis < 3 {
        let mut corner = 0;
        while corner < 8 {
            if corner & AXIS_BIT[axis] == 0 {
                list[n] = Edge { corner, axis };
                n += 1;
            }
            corner += 1;
        }
        axis += 1;
    }
    list
}

/// Triangulation of one closed loop of the contour in a cell. A vertex is identified by its cell
/// edge.
enum Piece {
    Triangles(Vec<[u8; 3]>),
    /// A loop that is triangulated as a fan around an extra vertex at the mean of the loop's
    /// vertices. Every triangulation without an extra vertex has a diagonal on a cell face.
    Fan(Vec<u8>),
}

/// The contour for one pattern of inside corners.
struct Case {
    /// Faces whose only inside corners are the first and the third. Bit n of a variant number
    /// belongs to face n.
    ambiguous: Vec<[u8; 4]>,
    /// The contour of each variant, that is, for each choice of the ambiguous faces whose inside
    /// corners are joined.
    variants: Vec<Vec<Piece>>,
}

fn table() -> &'static [Case] {
    static TABLE: OnceLock<Vec<Case>> = OnceLock::new();
    TABLE.get_or_init(|| {
        let case = |case: u8| {
            let ambiguous = ambiguous_faces(case);
            let contour = |variant| loops(case, variant).into_iter().map(cut).collect();
            Case { variants: (0..1usize << ambiguous.len()).map(contour).collect(), ambiguous }
        };
        (0..=255).map(case).collect()
    })
}

/// Returns the faces whose only inside corners are two diagonally opposite ones, rotated so that
/// these are the first and the third.
fn ambiguous_faces(case: u8) -> Vec<[u8; 4]> {
    let pattern = |face: [u8; 4]| face.map(|corner| case >> corner & 1 == 1);
    faces()
        .filter_map(|face| match pattern(face) {
            [true, false, true, false] => Some(face),
            [false, true, false, true] => Some([face[1], face[2], face[3], face[0]]),
            _ => None,
        })
        .collect()
}

/// Returns the edge of the cell between two adjacent corners.
fn edge_between(a: u8, b: u8) -> u8 {
    let low = a & b;
    let found = EDGES.iter().position(|e| e.corner == low && AXIS_BIT[e.axis] == a ^ b);
    found.expect("neighbouring corners of a face share an edge") as u8
}

/// Returns the four corners of each face of the cell, counter-clockwise when seen from outside the
/// cell.
fn faces() -> impl Iterator<Item = [u8; 4]> {
    (0..3usize).flat_map(|axis| {
        let (b, c) = (AXIS_BIT[(axis + 1) % 3], AXIS_BIT[(axis + 2) % 3]);
        let far = AXIS_BIT[axis];
        [[far, far | b, far | b | c, far | c], [0, c, b | c, b]]
    })
}

/// Returns the closed loops of the contour on the surface of the cell. All loops have the inside
/// corners on the same side. The bits of `variant` specify the ambiguous faces whose inside corners
/// are joined.
fn loops(case: u8, variant: usize) -> Vec<Vec<u8>> {
    let inside = |corner: u8| case >> corner & 1 == 1;
    let mut next = [None; 12];
    let mut ambiguous = 0;
    for face in faces() {
        let is_ambiguous = inside(face[0]) == inside(face[2])
            && inside(face[1]) != inside(face[0])
            && inside(face[1]) == inside(face[3]);
        let joined = is_ambiguous && variant >> ambiguous & 1 == 1;
        ambiguous += usize::from(is_ambiguous);
        for start in 0..4 {
            if !inside(face[start]) || inside(face[(start + 3) % 4]) {
                continue;
            }
            // a run of inside corners from `start` to `end`: one segment separates the run from the
            // other corners of the face
            let mut end = start;
            while inside(face[(end + 1) % 4]) {
                end = (end + 1) % 4;
            }
            if joined {
                // on a joined face, the segment cuts off the outside corner before `start`
                end = (end + 2) % 4;
            }
            let entering = edge_between(face[(start + 3) % 4], face[start]);
            let leaving = edge_between(face[end], face[(end + 1) % 4]);
            next[usize::from(entering)] = Some(leaving);
        }
    }
    let mut loops = Vec::new();
    for start in 0..12u8 {
        let mut cycle = Vec::new();
        let mut edge = start;
        while let Some(to) = next[usize::from(edge)].take() {
            cycle.push(edge);
            edge = to;
        }
        if !cycle.is_empty() {
            loops.push(cycle);
        }
    }
    loops
}

fn cut(cycle: Vec<u8>) -> Piece {
    let mut triangles = Vec::new();
    if cut_without_face_diagonals(&cycle, &mut triangles, &mut BTreeSet::new()) {
        Piece::Triangles(triangles)
    } else {
        Piece::Fan(cycle)
    }
}

/// Triangulates a cycle by ear clipping, without diagonals on a cell face. Backtracks if only such
/// diagonals remain. `given_up` contains the partial cycles that are known to have no such
/// triangulation. Returns whether a triangulation was found.
fn cut_without_face_diagonals(cycle: &[u8], triangles: &mut Vec<[u8; 3]>, given_up: &mut BTreeSet<Vec<u8>>) -> bool {
    if let &[a, b, c] = cycle {
        triangles.push([a, b, c]);
        return true;
    }
    if given_up.contains(cycle) {
        return false;
    }
    let n = cycle.len();
    for ear in 0..n {
        let (before, after) = (cycle[(ear + n - 1) % n], cycle[(ear + 1) % n]);
        if faces_of(before) & faces_of(after) != 0 {
            continue;
        }
        triangles.push([before, cycle[ear], after]);
        let rest: Vec<u8> = cycle.iter().copied().filter(|&e| e != cycle[ear]).collect();
        if cut_without_face_diagonals(&rest, triangles, given_up) {
            return true;
        }
        triangles.pop();
    }
    given_up.insert(cycle.to_vec());
    false
}

/// Returns a bit mask of the two cell faces that contain an edge.
fn faces_of(edge: u8) -> u8 {
    let Edge { corner, axis } = EDGES[usize::from(edge)];
    let face = |across: usize| 1 << (2 * across + usize::from(corner & AXIS_BIT[across] != 0));
    (0..3).filter(|&across| across != axis).map(face).sum()
}

#[cfg(test)]
mod tests;
