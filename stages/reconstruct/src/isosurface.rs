//! What the mesh has to have: the components of the isosurface and the Euler characteristic of each, and to which
//! component a place on the surface belongs.
//!
//! Marching cubes on the samples of F says it first. It sees straight lines between samples, where F is a cubic spline:
//! necks and gaps narrower than a voxel may differ. Where mesh and marching cubes disagree, [`Isosurface`] is therefore
//! asked to look again at the place on a finer sampling of the spline.

pub(crate) mod certain;

use certain::CertainSigns;
use glam::DVec3;
use isoparticles_field::marching_cubes::marching_cubes;
use isoparticles_field::spline::CubicSpline;
use isoparticles_mesh::incidence::Incidence;
use isoparticles_mesh::{TriangleMesh, components};
use isoparticles_volume::{Geometry, Image};
use rayon::prelude::*;
use std::collections::BTreeSet;

/// Samples a voxel edge of a second look.
const FINE: usize = 4;

/// Voxels around the place of a second look.
const MARGIN: f64 = 2.0;

/// Longest edge of the box round a small component, voxels.
const SMALL: f64 = 16.0;

/// Samples that a second look may take.
const MOST_SAMPLES: f64 = 1e7;

/// The isosurface F = 0 by components. Components that turn out to be one share a *class*: the number of its first.
#[derive(Clone, Debug)]
pub struct Isosurface {
    mesh: TriangleMesh,
    /// Component of each vertex of the mesh.
    component_of_vertex: Vec<u32>,
    /// (component, triangle), sorted.
    triangles: Vec<(u32, u32)>,
    /// First component of the class of each component.
    class: Vec<u32>,
    /// Components of each class, at the place of its first.
    members: Vec<Vec<u32>>,
    /// Euler characteristic of each class (2 for a ball, 0 for a torus).
    euler: Vec<i64>,
    /// Components beyond the first that a finer sampling finds in each class.
    parted: Vec<u32>,
    geometry: Geometry,
    /// Grid position of the first sample.
    corner: DVec3,
    /// (cell, triangle), sorted.
    cells: Vec<(u64, u32)>,
}

impl Isosurface {
    /// Triangulates F = 0 on its samples.
    pub fn new(image: &Image<f32>) -> Self {
        Self::of_mesh(marching_cubes(image, 0.0), image.geometry.clone(), DVec3::ZERO)
    }

    /// Samples the spline between two corners (cut at the volume, grid frame), `fine` times a voxel edge, or as often as
    /// the number of samples allows; `None` when that is less than once. Where the sign is certain all around, a sample is
    /// only that: marching cubes asks no more of it.
    fn patch(field: &CubicSpline, low: DVec3, high: DVec3, fine: usize) -> Option<Self> {
        let whole = field.geometry();
        let low = low.max(DVec3::ZERO);
        let extent = (high.min(whole.upper_corner()) - low).max(DVec3::ZERO);
        let voxels = (extent / whole.spacing).ceil() + 1.0;
        let affordable = (MOST_SAMPLES / (voxels.x * voxels.y * voxels.z)).cbrt().floor();
        let fine = (fine as f64).min(affordable);
        if fine < 1.0 {
            return None;
        }
        let spacing = whole.spacing / fine;
        let size = (extent / spacing).ceil().to_array().map(|n| n as usize + 1);
        let geometry = Geometry::axis_aligned(size, spacing);
        let certain = CertainSigns::new(field, low, low + extent);
        let mut data = vec![0.0f32; geometry.voxel_count()];
        data.par_chunks_mut(size[0]).enumerate().for_each(|(row, values)| {
            let (j, k) = ((row % size[1]) as f64, (row / size[1]) as f64);
            for (i, value) in values.iter_mut().enumerate() {
                let p = low + geometry.index_to_grid(DVec3::new(i as f64, j, k));
                *value = certain.at(p / whole.spacing).unwrap_or_else(|| field.value(p) as f32);
            }
        });
        let mut mesh = marching_cubes(&Image { geometry: geometry.clone(), data }, 0.0);
        mesh.vertices.iter_mut().for_each(|p| *p += low);
        Some(Self::of_mesh(mesh, geometry, low))
    }

    fn of_mesh(mesh: TriangleMesh, geometry: Geometry, corner: DVec3) -> Self {
        let (component_of_vertex, count) = components::of_vertices(mesh.vertices.len(), &mesh.triangles);
        let component_of: Vec<u32> = mesh.triangles.iter().map(|t| component_of_vertex[t[0] as usize]).collect();
        let euler = Incidence::new(&mesh.triangles, mesh.vertices.len()).euler_characteristics(&component_of, count);
        let class = (0..count as u32).collect();
        let members = (0..count as u32).map(|c| vec![c]).collect();
        let mut triangles: Vec<(u32, u32)> = (0..).zip(&component_of).map(|(t, &component)| (component, t)).collect();
        triangles.par_sort_unstable();
        let mut new = Self {
            mesh,
            component_of_vertex,
            triangles,
            class,
            members,
            euler,
            parted: vec![0; count],
            geometry,
            corner,
            cells: Vec::new(),
        };
        let mut cells: Vec<(u64, u32)> = (0..new.mesh.triangles.len() as u32)
            .into_par_iter()
            .map(|t| (new.cell(new.centroid(t), [0; 3]), t))
            .collect();
        cells.par_sort_unstable();
        new.cells = cells;
        new
    }

    /// The classes: the numbers that [`Isosurface::component_at`] gives.
    pub fn classes(&self) -> impl Iterator<Item = u32> + '_ {
        (0..self.class.len() as u32).filter(|&c| self.class[c as usize] == c)
    }

    /// One more than the largest class.
    pub fn class_bound(&self) -> usize {
        self.class.len()
    }

    /// Number of components of the isosurface, as far as it is known by now.
    pub fn component_count(&self) -> usize {
        self.classes().map(|c| 1 + self.parted[c as usize] as usize).sum()
    }

    /// Number of components by marching cubes on the samples alone.
    pub fn sampled_component_count(&self) -> usize {
        self.class.len()
    }

    /// Euler characteristic of a class.
    pub fn euler(&self, class: u32) -> i64 {
        self.euler[class as usize]
    }

    /// Components that a class is known to have: one, as a rule.
    pub fn pieces(&self, class: u32) -> usize {
        1 + self.parted[class as usize] as usize
    }

    /// Notes how many components a class turned out to have: more than one where marching cubes joins them, fewer than before where
    /// points added since have closed a gap.
    pub fn set_pieces(&mut self, class: u32, pieces: usize) {
        self.euler[class as usize] += 2 * (pieces as i64 - self.pieces(class) as i64);
        self.parted[class as usize] = pieces as u32 - 1;
    }

    /// Notes the Euler characteristic that a class turned out to have.
    pub fn set_euler(&mut self, class: u32, euler: i64) {
        self.euler[class as usize] = euler;
    }

    /// Class of a component or of a former class.
    pub fn class_of(&self, component: u32) -> u32 {
        self.class.get(component as usize).copied().unwrap_or(component)
    }

    fn class_of_triangle(&self, t: u32) -> u32 {
        let vertex = self.mesh.triangles[t as usize][0];
        self.class[self.component_of_vertex[vertex as usize] as usize]
    }

    /// Joins two classes by a neck: the Euler characteristic of the connected sum.
    pub fn merge(&mut self, a: u32, b: u32) {
        // either may have been merged with a third since its caller looked
        let (a, b) = (self.class_of(a), self.class_of(b));
        let (kept, gone) = (a.min(b), a.max(b));
        if kept != gone {
            self.euler[kept as usize] += self.euler[gone as usize] - 2;
            self.parted[kept as usize] += self.parted[gone as usize];
            let joining = std::mem::take(&mut self.members[gone as usize]);
            joining.iter().for_each(|&c| self.class[c as usize] = kept);
            self.members[kept as usize].extend(joining);
        }
    }

    fn triangles_of(&self, component: u32) -> impl Iterator<Item = u32> + '_ {
        let start = self.triangles.partition_point(|&(c, _)| c < component);
        self.triangles[start..].iter().take_while(move |&&(c, _)| c == component).map(|&(_, t)| t)
    }

    /// Triangles whose centroids lie in a box.
    fn triangles_within(&self, low: DVec3, high: DVec3) -> impl Iterator<Item = u32> + '_ {
        let rows = [low, high].map(|p| self.geometry.grid_to_index(p - self.corner).floor().max(DVec3::NEG_ONE));
        let [first, last] = rows.map(|index| index.as_i64vec3());
        let rows = (first.z..=last.z).flat_map(move |z| (first.y..=last.y).map(move |y| [y, z]));
        let in_row = rows.flat_map(move |[y, z]| {
            let [first, last] = [first.x, last.x].map(|x| key([x, y, z]));
            let start = self.cells.partition_point(|&(c, _)| c < first);
            self.cells[start..].iter().take_while(move |&&(c, _)| c <= last).map(|&(_, t)| t)
        });
        in_row.filter(move |&t| {
            let p = self.centroid(t);
            p.cmpge(low).all() && p.cmple(high).all()
        })
    }

    /// The marching-cubes vertices and the centroids of the triangles of a class: a dense sample of it.
    pub fn samples(&self, class: u32) -> Vec<DVec3> {
        let members = self.members[class as usize].iter();
        let mut triangles: Vec<u32> = members.flat_map(|&component| self.triangles_of(component)).collect();
        triangles.sort_unstable();
        let mut vertices: Vec<u32> = triangles.iter().flat_map(|&t| self.mesh.triangles[t as usize]).collect();
        vertices.sort_unstable();
        vertices.dedup();
        let vertices = vertices.into_iter().map(|v| self.mesh.vertices[v as usize]);
        vertices.chain(triangles.into_iter().map(|t| self.centroid(t))).collect()
    }

    /// Samples of a small class by a finer sampling of the spline: of a needle or a flake the volume's own may show a line. As many times
    /// finer as a second look, and each further `look` twice that; none where the class is large.
    pub fn finer_samples(&self, field: &CubicSpline, class: u32, look: usize) -> Vec<DVec3> {
        let samples = self.samples(class);
        let Some((low, high)) = self.small_box(&samples, 1.0) else { return Vec::new() };
        let Some(patch) = Self::patch(field, low, high, FINE << look) else { return Vec::new() };
        let own = samples.iter().filter_map(|&p| patch.component_at(p, field.value_gradient(p).1));
        let own: BTreeSet<u32> = own.collect();
        // a coarse sample may lie next to another sheet
        let is_own = |p: &DVec3| self.component_at(*p, field.value_gradient(*p).1) == Some(class);
        own.into_iter().flat_map(|component| patch.samples(component)).filter(is_own).collect()
    }

    /// The class that a point on F = 0 belongs to: that of the nearest marching-cubes triangle in its cell and the
    /// cells around it that faces the way of `normal`. `None` when there is none.
    pub fn component_at(&self, point: DVec3, normal: DVec3) -> Option<u32> {
        let mut best: Option<(bool, f64, u32)> = None;
        for z in -1..=1 {
            for y in -1..=1 {
                for x in -1..=1 {
                    let cell = self.cell(point, [x, y, z]);
                    let start = self.cells.partition_point(|&(c, _)| c < cell);
                    for &(_, t) in self.cells[start..].iter().take_while(|&&(c, _)| c == cell) {
                        let [a, b, c] = self.mesh.triangles[t as usize].map(|v| self.mesh.vertices[v as usize]);
                        let turned = (b - a).cross(c - a).dot(normal) <= 0.0;
                        let distance = self.centroid(t).distance_squared(point);
                        if best.is_none_or(|(worse, far, _)| (turned, distance) < (worse, far)) {
                            best = Some((turned, distance, t));
                        }
                    }
                }
            }
        }
        best.map(|(_, _, t)| self.class_of_triangle(t))
    }

    /// Looks again whether two points of different classes lie on one component between them. Each further `look` is twice as fine and half as
    /// wide, for necks that are thinner still.
    pub fn joins(field: &CubicSpline, points: [DVec3; 2], look: usize) -> bool {
        let Some(bounds) = bounds(&points) else { return false };
        let Some(patch) = Self::finer_patch(field, bounds, look) else { return false };
        let [a, b] = points.map(|p| patch.component_at(p, field.value_gradient(p).1));
        a.is_some() && a == b
    }

    /// Looks again whether a small class is joined to others around it, and says to which.
    pub fn joined_to(&self, field: &CubicSpline, class: u32) -> Vec<u32> {
        let samples = self.samples(class);
        let Some((low, high)) = self.small_box(&samples, MARGIN) else { return Vec::new() };
        let Some(patch) = Self::patch(field, low, high, FINE) else { return Vec::new() };
        let at = |p: DVec3| patch.component_at(p, field.value_gradient(p).1);
        let own: BTreeSet<u32> = samples.iter().filter_map(|&p| at(p)).collect();
        let mut joined: Vec<u32> = self
            .triangles_within(low, high)
            .filter(|&t| self.class_of_triangle(t) != class)
            .filter(|&t| at(self.centroid(t)).is_some_and(|c| own.contains(&c)))
            .map(|t| self.class_of_triangle(t))
            .collect();
        joined.sort_unstable();
        joined.dedup();
        joined
    }

    /// Looks again whether a piece of the mesh is a component of its own within a box, although marching cubes joins it to `others`: both given
    /// by the vertices in the box and, by [`Isosurface::margin`], around it. Each further `look` samples twice as finely.
    pub fn is_separate(
        field: &CubicSpline,
        bounds: (DVec3, DVec3),
        piece: &[DVec3],
        others: &[DVec3],
        look: usize,
    ) -> bool {
        let Some(patch) = Self::finer_patch(field, bounds, look) else { return false };
        let labels = |points: &[DVec3]| {
            let labels = points.iter().filter_map(|&p| patch.component_at(p, field.value_gradient(p).1));
            labels.collect::<BTreeSet<u32>>()
        };
        // without any of the others the box tells nothing of the gap
        let (own, others) = (labels(piece), labels(others));
        !own.is_empty() && !others.is_empty() && own.is_disjoint(&others)
    }

    /// A box with a margin (voxels) round points; `None` where it is large.
    fn small_box(&self, points: &[DVec3], margin: f64) -> Option<(DVec3, DVec3)> {
        let (low, high) = bounds(points)?;
        let spacing = self.geometry.spacing;
        let (low, high) = (low - spacing * margin, high + spacing * margin);
        (((high - low) / spacing).max_element() <= SMALL).then_some((low, high))
    }

    /// How far beyond the box that it is asked about a look sees, mm along each axis.
    pub fn margin(field: &CubicSpline, look: usize) -> DVec3 {
        field.geometry().spacing * (MARGIN / (1 << look) as f64)
    }

    fn finer_patch(field: &CubicSpline, (low, high): (DVec3, DVec3), look: usize) -> Option<Self> {
        let margin = Self::margin(field, look);
        Self::patch(field, low - margin, high + margin, FINE << look)
    }

    fn centroid(&self, triangle: u32) -> DVec3 {
        let [a, b, c] = self.mesh.triangles[triangle as usize].map(|v| self.mesh.vertices[v as usize]);
        (a + b + c) / 3.0
    }

    fn cell(&self, point: DVec3, shift: [i32; 3]) -> u64 {
        let index = self.geometry.grid_to_index(point - self.corner).floor();
        key([0, 1, 2].map(|axis| index[axis].max(-1.0) as i64 + i64::from(shift[axis])))
    }
}

/// Number of a cell; two cells of margin on the low side keep it positive.
fn key(cell: [i64; 3]) -> u64 {
    let [x, y, z] = cell.map(|n| (n + 2) as u64);
    (z << 42) | (y << 21) | x
}

/// Box round points.
pub(crate) fn bounds(points: &[DVec3]) -> Option<(DVec3, DVec3)> {
    let low = points.iter().copied().reduce(DVec3::min)?;
    let high = points.iter().copied().reduce(DVec3::max)?;
    Some((low, high))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scenes;

    fn euler(iso: &Isosurface) -> Vec<i64> {
        iso.classes().map(|c| iso.euler(c)).collect()
    }

    #[test]
    fn components_and_euler_characteristics_of_known_shapes() {
        assert_eq!(euler(&Isosurface::new(&scenes::torus().image)), [0]);
        assert_eq!(euler(&Isosurface::new(&scenes::shell().image)), [2, 2]);
        let scene = scenes::two_balls();
        let balls = Isosurface::new(&scene.image);
        assert_eq!(euler(&balls), [2, 2]);
        for component in 0..2 {
            let samples = balls.samples(component);
            assert!(samples.len() > 100);
            for p in samples {
                assert_eq!(balls.component_at(p, scene.gradient(p)), Some(component), "at {p}");
            }
        }
        assert_eq!(balls.component_at(DVec3::ZERO, DVec3::X), None);
    }

    #[test]
    fn facing_sheets_of_a_thin_wall_are_told_apart() {
        let scene = scenes::shell();
        let shell = Isosurface::new(&scene.image);
        for p in shell.samples(0) {
            let normal = scene.gradient(p);
            assert_eq!(shell.component_at(p + normal * 0.4, normal), Some(0));
        }
    }

    #[test]
    fn a_second_look_joins_what_only_the_samples_part() {
        // single nodes off the rim of this gyroid hang on to it by necks thinner than a voxel
        let scene = scenes::gyroid();
        let mut gyroid = Isosurface::new(&scene.image);
        assert_eq!(euler(&gyroid), [2, -14, 2, 2]);
        for class in [0, 2, 3] {
            let others = gyroid.joined_to(&scene.field, gyroid.class_of(class));
            assert!(!others.is_empty() || class > 0);
            others.into_iter().for_each(|other| gyroid.merge(class, other));
        }
        assert_eq!(euler(&gyroid), [-14]);
        assert_eq!((gyroid.component_count(), gyroid.sampled_component_count()), (1, 4));
    }

    #[test]
    fn a_patch_is_the_surface_of_all_its_samples() {
        for scene in [scenes::gyroid(), scenes::shell(), scenes::torus()] {
            let corner = scene.field.geometry().upper_corner();
            for (low, high, fine) in [(DVec3::ZERO, corner, 2), (corner * 0.23, corner * 0.61, 3)] {
                let patch = Isosurface::patch(&scene.field, low, high, fine).unwrap();
                let geometry = patch.geometry.clone();
                let mut data = vec![0.0f32; geometry.voxel_count()];
                for (n, value) in data.iter_mut().enumerate() {
                    let [nx, ny, _] = geometry.size;
                    let index = DVec3::new((n % nx) as f64, (n / nx % ny) as f64, (n / nx / ny) as f64);
                    *value = scene.field.value(patch.corner + geometry.index_to_grid(index)) as f32;
                }
                let mut mesh = marching_cubes(&Image { geometry, data }, 0.0);
                mesh.vertices.iter_mut().for_each(|p| *p += patch.corner);
                assert!(!mesh.triangles.is_empty());
                assert_eq!((mesh.vertices, mesh.triangles), (patch.mesh.vertices, patch.mesh.triangles));
            }
        }
    }

    #[test]
    fn classes_merged_in_a_chain_are_one() {
        let mut gyroid = Isosurface::new(&scenes::gyroid().image);
        gyroid.merge(1, 2);
        gyroid.merge(0, 1);
        gyroid.merge(2, 3);
        assert_eq!(gyroid.classes().collect::<Vec<_>>(), [0]);
        assert!((0..4).all(|c| gyroid.class_of(c) == 0));
        assert_eq!(euler(&gyroid), [-14]);
    }

    #[test]
    fn a_second_look_leaves_apart_what_is_apart() {
        let scene = scenes::two_balls();
        let balls = Isosurface::new(&scene.image);
        let (p, q) = (DVec3::new(14.6, 11.6, 11.6), DVec3::new(16.6, 11.6, 11.6));
        assert!(!Isosurface::joins(&scene.field, [p, q], 0));
        assert!(balls.joined_to(&scene.field, 0).is_empty());
        assert_eq!(balls.component_count(), 2);
    }
}
