//! Contracts segments of junction curves at a scale. Two junction points that are much closer than
//! h force poor triangles on the curve between them. They become one point of more materials, and
//! vertices of curves next to a junction point are merged into it.
//!
//! A contraction keeps the surface of every material a manifold of the same topology (link
//! condition; Dey, Edelsbrunner, Guha and Nekhayev 1999). It does not lower the minimum radius
//! ratio around it, turn a triangle, or let triangles intersect.

use super::segments::Segments;
use crate::interfaces::{Interfaces, Joined, Segment, segment};
use glam::DVec3;
use isoparticles_field::materials::{MaterialId, Stratum};
use isoparticles_mesh::incidence::Incidence;
use isoparticles_mesh::intersect::corners_cross;
use isoparticles_mesh::quality::radius_ratio;
use isoparticles_mesh::spatial::{Bins, Bounds};
use std::collections::BTreeMap;

/// Fraction s of h below which [`Which::Short`] selects a segment. A triangle on such a segment
/// between fixed vertices with two sides of length h has a radius ratio of s (2 - s) = 0.44.
/// Without these contractions, the improvement of `brain_parcellation` at 100,000 vertices takes 49
/// instead of 13 s.
const SHORT_SEGMENT: f64 = 0.25;

/// Radius ratio below which [`Which::Limiting`] selects the sides of a triangle. After the first
/// improvement, 69 of 861,518 triangles of `brain_parcellation` at 400,000 vertices are below it.
/// All of them have two or three vertices on junction curves.
const POOR: f64 = 0.45;

/// Maximum length of a segment that [`Which::Limiting`] selects, in units of h.
const LONGEST: f64 = 0.5;

/// Minimum cosine between the normals of a triangle before and after a contraction: 60 degrees.
const LEAST_AGREEMENT: f64 = 0.5;

/// Maximum ratio of the first-order distance from an interface, |G| / |grad G|, to the distance of
/// a vertex at which strata are merged. It is at most 2.44 at 59 merged points of
/// `brain_parcellation` at 100,000 vertices.
const ESTIMATE_OVER_DISTANCE: f64 = 3.0;

/// A mesh of interfaces whose segments are contracted.
struct Contraction<'a> {
    interfaces: &'a mut Interfaces,
    /// Dimension of the stratum of each vertex.
    dimensions: &'a mut [usize],
    segments: Segments,
    /// Segments with an end in no triangle, which has the number `u32::MAX`.
    lost: Vec<(Segment, Stratum)>,
    /// Distance (mm) of joined vertices from some of their interfaces.
    joined: BTreeMap<u32, f64>,
    /// The triangles at each vertex.
    around: Vec<Vec<u32>>,
    /// The triangles by their centroids before the contractions. The side of a bin exceeds the
    /// distance between the centroids of two triangles that intersect.
    bins: Bins<u32>,
}

/// Selects segments with an end at a junction point.
#[derive(Clone, Copy)]
pub(super) enum Which {
    /// Segments shorter than [`SHORT_SEGMENT`] h.
    Short,
    /// Segments shorter than [`LONGEST`] h that are sides of triangles below [`POOR`]. After an
    /// improvement, such segments limit the quality of their triangles.
    Limiting,
}

/// Contracts segments, and returns the points into which vertices were merged, one for each
/// contraction. `dimensions` contains the dimension of the stratum of each vertex, and `size`
/// returns h (mm). Vertices and triangles are renumbered.
pub(super) fn contract(
    interfaces: &mut Interfaces,
    dimensions: &mut Vec<usize>,
    which: Which,
    size: &dyn Fn(DVec3) -> f64,
) -> Vec<u32> {
    let mut contraction = Contraction::new(interfaces, dimensions);
    let mut points = Vec::new();
    // a contraction can make other segments short
    loop {
        let before = points.len();
        for [a, b] in contraction.selected(which, size) {
            // an earlier contraction may have removed the segment
            let is_current = contraction.segments.curve([a, b]).is_some();
            let of_point = |keep: u32| contraction.dimensions[keep as usize] == 0;
            let orders = [[a, b], [b, a]].into_iter().filter(|[keep, _]| is_current && of_point(*keep));
            if let Some([keep, gone]) = orders.into_iter().find(|&[keep, gone]| contraction.is_possible(keep, gone)) {
                contraction.apply(keep, gone);
                points.iter_mut().filter(|v| **v == gone).for_each(|v| *v = keep);
                points.push(keep);
            }
        }
        if points.len() == before {
            break;
        }
    }
    if !points.is_empty() {
        let number = contraction.finish();
        points.iter_mut().for_each(|v| *v = number[*v as usize]);
        dimensions.truncate(interfaces.mesh.vertices.len());
    }
    points
}

impl<'a> Contraction<'a> {
    fn new(interfaces: &'a mut Interfaces, dimensions: &'a mut [usize]) -> Self {
        let mesh = &interfaces.mesh;
        let incidence = Incidence::new(&mesh.triangles, mesh.vertices.len());
        let around = (0..mesh.vertices.len() as u32).map(|v| incidence.of(v).to_vec()).collect();
        let corners = || (0..mesh.triangles.len()).map(|t| mesh.corners(t));
        let longest = corners().flat_map(|[a, b, c]| [a.distance(b), b.distance(c), c.distance(a)]).fold(0.0, f64::max);
        // a centroid is within two thirds of the longest side from each point of its triangle; the
        // rest is for corners that move
        let mut bins = Bins::new(2.0 * longest);
        corners().enumerate().for_each(|(t, [a, b, c])| bins.add((a + b + c) / 3.0, t as u32));
        let (lost, found): (Vec<_>, Vec<_>) = interfaces.segments.iter().partition(|([_, b], _)| *b == u32::MAX);
        let segments = Segments::new(found, &mesh.vertices);
        let joined = interfaces.joined.iter().map(|own| (own.vertex, own.distance)).collect();
        Self { interfaces, dimensions, segments, lost, joined, around, bins }
    }

    fn place(&self, vertex: u32) -> DVec3 {
        self.interfaces.mesh.vertices[vertex as usize]
    }

    fn length(&self, a: u32, b: u32) -> f64 {
        self.place(a).distance(self.place(b))
    }

    /// Returns the selected segments, the shortest first.
    fn selected(&self, which: Which, size: &dyn Fn(DVec3) -> f64) -> Vec<Segment> {
        let (limit, segments): (f64, Vec<Segment>) = match which {
            Which::Short => (SHORT_SEGMENT, self.segments.all().map(|(pair, _)| pair).collect()),
            Which::Limiting => (LONGEST, self.sides_of_poor()),
        };
        let is_selected = |&(length, [a, b]): &(f64, Segment)| {
            let has_point = [a, b].iter().any(|&v| self.dimensions[v as usize] == 0);
            has_point && length < limit * size(self.place(a).midpoint(self.place(b)))
        };
        let measured = segments.into_iter().map(|[a, b]| (self.length(a, b), [a, b]));
        let mut selected: Vec<(f64, Segment)> = measured.filter(is_selected).collect();
        selected.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
        selected.into_iter().map(|(_, pair)| pair).collect()
    }

    /// Returns the segments that are sides of triangles below [`POOR`], ascending.
    fn sides_of_poor(&self) -> Vec<Segment> {
        let is_poor =
            |[a, b, c]: &&[u32; 3]| a != b && radius_ratio(self.place(*a), self.place(*b), self.place(*c)) < POOR;
        let poor = self.interfaces.mesh.triangles.iter().filter(is_poor);
        let sides = poor.flat_map(|&[a, b, c]| [segment(a, b), segment(b, c), segment(c, a)]);
        let mut sides: Vec<Segment> = sides.filter(|&side| self.segments.curve(side).is_some()).collect();
        sides.sort_unstable();
        sides.dedup();
        sides
    }

    /// Returns the triangles of a material at a vertex.
    fn star(&self, vertex: u32, id: MaterialId) -> impl Iterator<Item = u32> + '_ {
        let own = self.around[vertex as usize].iter().copied();
        own.filter(move |&t| self.interfaces.between[t as usize].contains(&id))
    }

    /// Returns the neighbours of a vertex on the surface of a material, ascending.
    fn ring(&self, vertex: u32, id: MaterialId) -> Vec<u32> {
        let corners = self.star(vertex, id).flat_map(|t| self.interfaces.mesh.triangles[t as usize]);
        let mut ring: Vec<u32> = corners.filter(|&v| v != vertex).collect();
        ring.sort_unstable();
        ring.dedup();
        ring
    }

    /// Returns the materials at a vertex, ascending.
    fn materials(&self, vertex: u32) -> Vec<MaterialId> {
        let mut ids: Vec<MaterialId> =
            self.around[vertex as usize].iter().flat_map(|&t| self.interfaces.between[t as usize]).collect();
        ids.sort_unstable();
        ids.dedup();
        ids
    }

    /// Returns whether `gone` can be merged into its neighbour `keep`.
    fn is_possible(&self, keep: u32, gone: u32) -> bool {
        let own = self.materials(gone);
        let common: Vec<MaterialId> = self.materials(keep).into_iter().filter(|id| own.contains(id)).collect();
        !common.is_empty()
            && common.into_iter().all(|id| self.keeps_manifold(keep, gone, id))
            && self.segments.can_merge(gone, keep)
            && self.keeps_shapes(keep, gone)
    }

    /// Returns whether the surface of a material satisfies the link condition: the two vertices
    /// have the two corners opposite their common edge as their only common neighbours.
    fn keeps_manifold(&self, keep: u32, gone: u32, id: MaterialId) -> bool {
        let triangle = |t: u32| self.interfaces.mesh.triangles[t as usize];
        let at_edge = self.star(gone, id).filter(|&t| triangle(t).contains(&keep));
        let mut opposite: Vec<u32> = at_edge.flat_map(triangle).filter(|&v| v != keep && v != gone).collect();
        opposite.sort_unstable();
        let [first, second] = [self.ring(keep, id), self.ring(gone, id)];
        let shared: Vec<u32> = first.iter().copied().filter(|v| second.binary_search(v).is_ok()).collect();
        let is_large = first.len() + second.len() > 6 && opposite.iter().all(|&v| self.ring(v, id).len() > 3);
        opposite.len() == 2 && shared == opposite && is_large
    }

    /// Returns whether the triangles that follow `gone` to `keep` keep the minimum radius ratio,
    /// are not turned, and intersect no other triangle.
    fn keeps_shapes(&self, keep: u32, gone: u32) -> bool {
        let mesh = &self.interfaces.mesh;
        let ratio = |[a, b, c]: [DVec3; 3]| radius_ratio(a, b, c);
        let normal = |[a, b, c]: [DVec3; 3]| (b - a).cross(c - a).normalize_or_zero();
        let both = [keep, gone].into_iter().flat_map(|v| self.around[v as usize].iter());
        let before = both.map(|&t| ratio(mesh.corners(t as usize))).fold(1.0, f64::min);
        let follows = |t: &&u32| !mesh.triangles[**t as usize].contains(&keep);
        let moved = |&t: &u32| {
            let corners = mesh.triangles[t as usize].map(|v| if v == gone { keep } else { v });
            (t, corners, corners.map(|v| self.place(v)))
        };
        let new: Vec<(u32, [u32; 3], [DVec3; 3])> =
            self.around[gone as usize].iter().filter(follows).map(moved).collect();
        let is_sound = new.iter().all(|(t, _, places)| {
            ratio(*places) >= before && normal(*places).dot(normal(mesh.corners(*t as usize))) >= LEAST_AGREEMENT
        });
        let is_crossed = |(_, corners, places): &(u32, [u32; 3], [DVec3; 3])| {
            let bounds = Bounds::of(places);
            let others = self.bins.near((places[0] + places[1] + places[2]) / 3.0);
            // triangles that a contraction removed have equal corners
            let is_other = |&&t: &&u32| {
                let corners = mesh.triangles[t as usize];
                corners[0] != corners[1] && !corners.contains(&gone)
            };
            others.filter(is_other).any(|&t| {
                let other = mesh.corners(t as usize);
                Bounds::of(&other).meets(&bounds) && corners_cross(*corners, *places, mesh.triangles[t as usize], other)
            })
        };
        let cross = |first: usize, second: usize| {
            let [(_, a, p), (_, b, q)] = [&new[first], &new[second]];
            corners_cross(*a, *p, *b, *q)
        };
        is_sound && !new.iter().any(is_crossed) && !(0..new.len()).any(|n| (0..n).any(|other| cross(n, other)))
    }

    /// Merges `gone` into `keep`.
    fn apply(&mut self, keep: u32, gone: u32) {
        let of_gone = self.joined.remove(&gone).unwrap_or_default();
        let distance = ESTIMATE_OVER_DISTANCE * self.length(keep, gone) + of_gone;
        let own = self.joined.entry(keep).or_default();
        *own = own.max(distance);
        self.segments.merge(gone, keep, &self.interfaces.mesh.vertices);
        for ([a, _], _) in &mut self.lost {
            if *a == gone {
                *a = keep;
            }
        }
        for t in std::mem::take(&mut self.around[gone as usize]) {
            let corners = &mut self.interfaces.mesh.triangles[t as usize];
            if corners.contains(&keep) {
                for v in std::mem::replace(corners, [keep; 3]) {
                    self.around[v as usize].retain(|&other| other != t);
                }
            } else {
                *corners = corners.map(|v| if v == gone { keep } else { v });
                self.around[keep as usize].push(t);
            }
        }
    }

    /// Removes the vertices and triangles that are gone, and renumbers the others. Returns the new
    /// number of each vertex, `u32::MAX` if it is gone.
    fn finish(self) -> Vec<u32> {
        let Self { interfaces, dimensions, segments, lost, joined, around, .. } = self;
        let mut number = vec![u32::MAX; around.len()];
        let kept: Vec<usize> = (0..around.len()).filter(|&v| !around[v].is_empty()).collect();
        kept.iter().enumerate().for_each(|(n, &v)| {
            number[v] = n as u32;
            dimensions[n] = dimensions[v];
        });
        let mesh = &mut interfaces.mesh;
        mesh.vertices = kept.iter().map(|&v| mesh.vertices[v]).collect();
        let is_alive: Vec<bool> = mesh.triangles.iter().map(|[a, b, _]| a != b).collect();
        let mut alive = is_alive.iter();
        interfaces.between.retain(|_| *alive.next().unwrap_or(&false));
        mesh.triangles.retain(|[a, b, _]| a != b);
        mesh.triangles.iter_mut().for_each(|corners| *corners = corners.map(|v| number[v as usize]));
        let new = |v: u32| number.get(v as usize).copied().unwrap_or(u32::MAX);
        interfaces.segments = segments.all().chain(lost).map(|(pair, curve)| (pair.map(new), curve)).collect();
        interfaces.segments.sort_unstable();
        interfaces.joined =
            joined.into_iter().map(|(vertex, distance)| Joined { vertex: new(vertex), distance }).collect();
        number
    }
}

#[cfg(test)]
mod tests {
    use super::super::reconstruct::reconstruct;
    use super::super::scenes;
    use super::*;
    use crate::options::Options;
    use isoparticles_mesh::TriangleMesh;
    use isoparticles_stage::monitor::Silent;

    /// Returns the triangles of interfaces as sorted positions.
    fn places(interfaces: &Interfaces) -> Vec<Vec<[u64; 3]>> {
        let bits = |v: u32| interfaces.mesh.vertices[v as usize].to_array().map(f64::to_bits);
        let corners = |t: &[u32; 3]| {
            let mut corners = t.map(bits).to_vec();
            corners.sort_unstable();
            corners
        };
        let mut all: Vec<_> = interfaces.mesh.triangles.iter().map(corners).collect();
        all.sort_unstable();
        all
    }

    #[test]
    fn a_short_segment_at_a_junction_point_is_contracted() {
        let scene = scenes::quarters();
        let (particles, strata) = scene.particles(1.5, 0.75);
        let options = Options { keeps_voxels: false, ..Options::default() };
        let made = reconstruct((&particles, &strata), &scene.analytic, &scene.table(), None, &options, &Silent);
        let whole = made.expect("on their strata").interfaces;
        let meets = whole.materials_at_vertices();
        let is_point = |v: u32| meets[v as usize].len() > 3;
        let mut dimensions: Vec<usize> = meets.iter().map(|ids| 4 - ids.len()).collect();
        let mut split = whole.clone();
        assert_eq!(contract(&mut split, &mut dimensions.clone(), Which::Short, &|_| 1.5), [0; 0]);
        assert_eq!(split, whole, "no segment is short");

        // splits the first segment at a junction point, close to the point
        let at = whole.segments.iter().position(|(pair, _)| pair.iter().any(|&v| is_point(v))).expect("a segment");
        let (pair, curve) = split.segments.remove(at);
        let [point, other] = if is_point(pair[0]) { pair } else { [pair[1], pair[0]] };
        let place = whole.mesh.vertices[point as usize].lerp(whole.mesh.vertices[other as usize], 0.1);
        let new = split.mesh.vertices.len() as u32;
        split.mesh.vertices.push(place);
        dimensions.push(1);
        split.segments.extend([point, other].map(|end| (segment(end, new), curve)));
        split.segments.sort_unstable();
        for t in 0..whole.mesh.triangles.len() {
            let corners = whole.mesh.triangles[t];
            if corners.contains(&point) && corners.contains(&other) {
                let instead = |gone: u32| corners.map(|v| if v == gone { new } else { v });
                split.mesh.triangles[t] = instead(point);
                split.mesh.triangles.push(instead(other));
                split.between.push(whole.between[t]);
            }
        }
        // the triangles at the short segment are below the limit of `Which::Limiting`
        for which in [Which::Short, Which::Limiting] {
            let (mut made, mut dimensions) = (split.clone(), dimensions.clone());
            assert_eq!(contract(&mut made, &mut dimensions, which, &|_| 1.5), [point]);
            assert_eq!((places(&made), &made.segments), (places(&whole), &whole.segments));
            assert_eq!((dimensions.len(), made.joined.len()), (whole.mesh.vertices.len(), 1));
        }
        // 0.1 of an edge is longer than 0.25 h if h is a tenth
        assert_eq!(contract(&mut split, &mut dimensions, Which::Short, &|_| 0.15), [0; 0]);
    }

    #[test]
    fn segments_whose_contraction_changes_the_topology_stay() {
        // two tetrahedra with a common face, whose sides are short segments between junction points
        let vertices = [DVec3::ZERO, DVec3::X, DVec3::Y, DVec3::Z, DVec3::NEG_Z].to_vec();
        let triangles = vec![[0, 2, 1], [0, 1, 3], [1, 2, 3], [2, 0, 3], [1, 0, 4], [2, 1, 4], [0, 2, 4]];
        let pair = |ids: [u16; 2]| ids.map(MaterialId);
        let between = [vec![pair([2, 1])], vec![pair([2, 0]); 3], vec![pair([1, 0]); 3]].concat();
        let curve = scenes::stratum(&[0, 1, 2]);
        let segments = [[0, 1], [0, 2], [1, 2]].map(|pair| (pair, curve)).to_vec();
        let mut tetrahedra =
            Interfaces { mesh: TriangleMesh { vertices, triangles }, between, segments, ..Interfaces::default() };
        let before = tetrahedra.clone();
        assert_eq!(contract(&mut tetrahedra, &mut vec![0, 0, 0, 2, 2], Which::Short, &|_| 100.0), [0; 0]);
        assert_eq!(tetrahedra, before);
    }
}
