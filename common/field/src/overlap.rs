//! Means of a voxel image over tetrahedra. The image is constant in each voxel, and the overlap of
//! voxels and tetrahedra is exact, so sums over a mesh are kept: total mass, for example.
//!
//! Let G be the integral of the image f along x. By the divergence theorem, the integral of f over
//! a tetrahedron is that of G n_x over its faces. The planes between voxels cut each face into
//! polygons on which G is linear, so that the area and the centroid of a polygon give its integral.

use glam::DVec3;
use isoparticles_mesh::tetrahedra::FACES;
use isoparticles_volume::Image;
use rayon::prelude::*;

/// Share of a tetrahedron at the border below which it counts as outside of the image. Rounding
/// errors of the share are below this in all but flat tetrahedra.
const MIN_SHARE: f64 = 1e-9;

/// A position in units of voxels. Voxel (i, j, k) contains positions from (i, j, k) to
/// (i + 1, j + 1, k + 1).
type Position = [f64; 3];

/// The image in a tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Overlap {
    /// Mean over the part inside the image; NaN if there is none.
    pub mean: f64,
    /// Share of the tetrahedron that lies inside the image, 0 to 1.
    pub share: f64,
}

impl Overlap {
    const NONE: Self = Self { mean: f64::NAN, share: 0.0 };
}

/// Computes the mean of a finite image over each tetrahedron. `points` are world positions. The
/// orientation of the tetrahedra does not matter. Flat ones get a value of the voxels near them.
pub fn overlaps(image: &Image<f32>, points: &[DVec3], tetrahedra: &[[u32; 4]]) -> Vec<Overlap> {
    let geometry = &image.geometry;
    let place = |&p: &DVec3| (geometry.grid_to_index(geometry.world_to_grid(p)) + 0.5).to_array();
    let places: Vec<Position> = points.par_iter().map(place).collect();
    let of_cell = |levels: &mut [Level; 3], cell: &[u32; 4]| overlap(image, cell.map(|v| places[v as usize]), levels);
    tetrahedra.par_iter().map_init(Default::default, of_cell).collect()
}

fn overlap(image: &Image<f32>, corners: [Position; 4], levels: &mut [Level; 3]) -> Overlap {
    let [nx, ny, nz] = image.geometry.size;
    let [a, b, c, d] = corners.map(DVec3::from_array);
    let volume = (b - a).cross(c - a).dot(d - a) / 6.0;
    let (low, high) = (a.min(b).min(c).min(d).floor(), a.max(b).max(c).max(d).floor());
    let size = DVec3::new(nx as f64, ny as f64, nz as f64);
    let [i, j, k] = low.clamp(DVec3::ZERO, size - 1.0).to_array().map(|n| n as usize);
    let first = f64::from(image.at(i, j, k));
    let is_inside = (low.cmpge(DVec3::ZERO) & high.cmplt(size)).all();
    if is_inside && low == high {
        return Overlap { mean: first, share: 1.0 };
    }
    let mut sum = Sum { start: i, reference: first, low: first, high: first, volume: 0.0, integral: 0.0 };
    let [zs, ys, xs] = levels;
    for face in FACES {
        zs.slabs::<2>(&face.map(|n| corners[n]), nz, |k, slice| {
            ys.slabs::<1>(slice, ny, |j, strip| {
                let inside = (0..nz as isize).contains(&k) && (0..ny as isize).contains(&j);
                if inside {
                    let row = &image.data[image.geometry.linear(0, j as usize, k as usize)..][..nx];
                    sum.add(row, strip, xs);
                }
            });
        });
    }
    let share = if is_inside { 1.0 } else { (sum.volume / volume).min(1.0) };
    if share >= MIN_SHARE { Overlap { mean: sum.mean(), share } } else { Overlap::NONE }
}

/// Integrals over the part of a tetrahedron that lies inside the image.
struct Sum {
    /// Voxel of a row from which G is integrated, at or before the tetrahedron.
    start: usize,
    /// Value that is subtracted from all voxels, so that a constant image has no rounding errors.
    reference: f64,
    /// Minimum of the voxels.
    low: f64,
    /// Maximum of the voxels.
    high: f64,
    /// Signed volume.
    volume: f64,
    /// Integral of the values above the reference.
    integral: f64,
}

impl Sum {
    /// Adds a polygon of the boundary that lies in one row of voxels along x.
    fn add(&mut self, row: &[f32], polygon: &[Position], level: &mut Level) {
        // G at the lower end of voxel `at`, for the image 1 and for the values above the reference
        let (mut at, mut length, mut before) = (self.start, 0.0, 0.0);
        level.slabs::<0>(polygon, row.len(), |slab, piece| {
            let Ok(voxel) = usize::try_from(slab) else { return };
            while at < voxel {
                length += 1.0;
                before += f64::from(row[at]) - self.reference;
                at += 1;
            }
            let (area, moment) = projected(piece, voxel as f64);
            self.volume += length * area;
            self.integral += before * area;
            if let Some(&value) = row.get(voxel) {
                let value = f64::from(value);
                (self.low, self.high) = (self.low.min(value), self.high.max(value));
                self.volume += moment;
                self.integral += (value - self.reference) * moment;
            }
        });
    }

    fn mean(&self) -> f64 {
        let above = if self.volume == 0.0 { 0.0 } else { self.integral / self.volume };
        // in a flat tetrahedron, the quotient of two rounding errors may be any number
        (self.reference + above).clamp(self.low, self.high)
    }
}

/// Returns the signed area of a polygon as seen along x, and its first moment about the plane at
/// `origin` across x.
fn projected(polygon: &[Position], origin: f64) -> (f64, f64) {
    let [a, rest @ ..] = polygon else { return (0.0, 0.0) };
    let (mut area, mut moment) = (0.0, 0.0);
    for (b, c) in rest.iter().zip(rest.iter().skip(1)) {
        let own = 0.5 * ((b[1] - a[1]) * (c[2] - a[2]) - (b[2] - a[2]) * (c[1] - a[1]));
        area += own;
        moment += own * ((a[0] - origin) + (b[0] - origin) + (c[0] - origin)) / 3.0;
    }
    (area, moment)
}

/// Polygons that are cut along one axis, kept to reuse their memory.
#[derive(Default)]
struct Level {
    rest: Vec<Position>,
    below: Vec<Position>,
    above: Vec<Position>,
}

impl Level {
    /// Cuts a convex polygon into slabs of one voxel along an axis. Slab -1 contains everything
    /// below the image of `count` voxels, and slab `count` everything above it.
    fn slabs<const AXIS: usize>(
        &mut self,
        polygon: &[Position],
        count: usize,
        mut act: impl FnMut(isize, &[Position]),
    ) {
        let ends = polygon
            .iter()
            .fold((f64::INFINITY, f64::NEG_INFINITY), |(low, high), p| (low.min(p[AXIS]), high.max(p[AXIS])));
        let slab = |at: f64| at.floor().clamp(-1.0, count as f64) as isize;
        let (first, last) = (slab(ends.0), slab(ends.1));
        if first == last {
            return act(first, polygon);
        }
        let (mut rest, mut above) = (&mut self.rest, &mut self.above);
        split::<AXIS>(polygon, (first + 1) as f64, &mut self.below, rest);
        act(first, &self.below);
        for own in first + 1..last {
            split::<AXIS>(rest, (own + 1) as f64, &mut self.below, above);
            act(own, &self.below);
            std::mem::swap(&mut rest, &mut above);
        }
        act(last, rest);
    }
}

/// Splits a convex polygon at a plane across an axis.
fn split<const AXIS: usize>(polygon: &[Position], plane: f64, below: &mut Vec<Position>, above: &mut Vec<Position>) {
    below.clear();
    above.clear();
    let Some(&last) = polygon.last() else { return };
    let mut a = last;
    for &b in polygon {
        let (from, to) = (a[AXIS], b[AXIS]);
        if (from < plane) != (to < plane) {
            let t = (plane - from) / (to - from);
            let mut crossing: Position = std::array::from_fn(|axis| a[axis] + t * (b[axis] - a[axis]));
            crossing[AXIS] = plane;
            below.push(crossing);
            above.push(crossing);
        }
        if to < plane {
            below.push(b)
        } else {
            above.push(b)
        }
        a = b;
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::random::uniform;
    use glam::DMat3;
    use isoparticles_volume::Geometry;

    const ONE: [[u32; 4]; 1] = [[0, 1, 2, 3]];

    /// A turned grid with different spacings; `f` maps index positions to values.
    fn image(f: impl Fn(DVec3) -> f64) -> Image<f32> {
        let geometry = Geometry {
            directions: DMat3::from_rotation_z(0.3) * DMat3::from_rotation_x(-0.7),
            origin: DVec3::new(40.0, -7.0, 3.0),
            ..Geometry::axis_aligned([9, 8, 7], DVec3::new(0.5, 1.0, 2.0))
        };
        Image::sampled(geometry.clone(), |p| f(geometry.grid_to_index(p)) as f32)
    }

    /// Random corners in world coordinates, with indices from -0.5 - `beyond` to 6.5 + `beyond`.
    fn corners(image: &Image<f32>, stream: u64, beyond: f64) -> Vec<DVec3> {
        let at = |n: u64| -0.5 - beyond + (7.0 + 2.0 * beyond) * uniform(1, stream, n);
        let index = |n: u64| DVec3::new(at(3 * n), at(3 * n + 1), at(3 * n + 2));
        let geometry = &image.geometry;
        (0..4).map(|n| geometry.grid_to_world(geometry.index_to_grid(index(n)))).collect()
    }

    /// Integrates by splitting tetrahedra at voxel planes into tetrahedra, with halved edges until
    /// each lies in one voxel: slow and independent of the polygons.
    fn sampled(image: &Image<f32>, corners: [DVec3; 4], depth: u32) -> (f64, f64) {
        let voxel = |p: DVec3| image.geometry.grid_to_index(image.geometry.world_to_grid(p)).round();
        let value = |v: DVec3| {
            let size = DVec3::from_array(image.geometry.size.map(|n| n as f64));
            let inside = (v.cmpge(DVec3::ZERO) & v.cmplt(size)).all();
            inside.then(|| f64::from(image.at(v.x as usize, v.y as usize, v.z as usize)))
        };
        let [a, b, c, d] = corners;
        let own = corners.map(voxel);
        if depth == 0 || own.iter().all(|&v| v == own[0]) {
            let volume = ((b - a).cross(c - a).dot(d - a) / 6.0).abs();
            return value(voxel((a + b + c + d) / 4.0)).map_or((0.0, 0.0), |value| (volume * value, volume));
        }
        let edges = [(0, 1), (0, 2), (0, 3), (1, 2), (1, 3), (2, 3)];
        let (from, to) = edges
            .into_iter()
            .max_by(|x, y| {
                let length = |edge: &(usize, usize)| corners[edge.0].distance(corners[edge.1]);
                length(x).total_cmp(&length(y))
            })
            .expect("there are edges");
        let middle = (corners[from] + corners[to]) / 2.0;
        let half =
            |n: usize| sampled(image, std::array::from_fn(|k| if k == n { middle } else { corners[k] }), depth - 1);
        let ((f, v), (g, w)) = (half(from), half(to));
        (f + g, v + w)
    }

    #[test]
    fn means_of_random_tetrahedra_match_a_subdivision() {
        let image = image(|v| (7.0 * v.x + 3.0 * v.y * v.z).sin() * 1000.0);
        for stream in 0..6 {
            let points = corners(&image, stream, if stream < 3 { 0.0 } else { 2.0 });
            let found = overlaps(&image, &points, &ONE)[0];
            let corners: [DVec3; 4] = points.try_into().expect("there are four");
            let [a, b, c, d] = corners;
            let volume = ((b - a).cross(c - a).dot(d - a) / 6.0).abs();
            let (integral, inside) = sampled(&image, corners, 20);
            assert!((found.share - inside / volume).abs() < 2e-3, "{stream}: {found:?} {}", inside / volume);
            assert!((found.mean - integral / inside).abs() < 2.0, "{stream}: {found:?} {}", integral / inside);
        }
    }

    #[test]
    fn overlaps_with_all_voxels_sum_to_the_integral() {
        // a box of six tetrahedra around a corner, with all voxels inside
        let image = image(|v| (v.x * 31.0 + v.y * 17.0 + v.z * 5.0) % 11.0 - 3.0);
        let size = image.geometry.size.map(|n| n as f64);
        let corner = |n: usize| {
            let index: [f64; 3] = std::array::from_fn(|axis| if n >> axis & 1 == 0 { -0.5 } else { size[axis] - 0.5 });
            image.geometry.grid_to_world(image.geometry.index_to_grid(DVec3::from_array(index)))
        };
        let points: Vec<DVec3> = (0..8).map(corner).collect();
        let cells = [[0, 1, 3, 7], [0, 3, 2, 7], [0, 2, 6, 7], [0, 6, 4, 7], [0, 4, 5, 7], [0, 5, 1, 7]];
        let found = overlaps(&image, &points, &cells);
        let expected = image.data.iter().map(|&f| f64::from(f)).sum::<f64>() / image.data.len() as f64;
        let mean = found.iter().map(|own| own.mean).sum::<f64>() / 6.0;
        assert!((mean - expected).abs() < 1e-12 * expected, "{mean} {expected}");
        assert!(found.iter().all(|own| (own.share - 1.0).abs() < 1e-12), "{found:?}");
    }

    #[test]
    fn a_constant_image_is_exact() {
        let image = image(|_| 1234.5);
        for stream in 0..20 {
            let found = overlaps(&image, &corners(&image, stream, 3.0), &ONE)[0];
            assert!(found.share == 0.0 || found.mean == 1234.5, "{found:?}");
        }
    }

    #[test]
    fn a_tetrahedron_half_inside_has_the_mean_of_that_half() {
        let geometry = Geometry::axis_aligned([2; 3], DVec3::ONE);
        let image = Image::sampled(geometry, |p| p.x as f32);
        // symmetric about the plane x = -0.5, where the image begins
        let points = [[-1.5, 0.0, 0.0], [0.5, 0.0, 0.0], [-0.5, 1.0, 0.0], [-0.5, 0.0, 1.0]].map(DVec3::from_array);
        let found = overlaps(&image, &points, &ONE)[0];
        assert!((found.share - 0.5).abs() < 1e-15 && found.mean == 0.0, "{found:?}");
    }

    #[test]
    fn tetrahedra_outside_have_no_mean() {
        let image = image(|_| 1.0);
        let points: Vec<DVec3> = corners(&image, 1, 0.0).iter().map(|&p| p + 100.0).collect();
        let found = overlaps(&image, &points, &ONE)[0];
        assert!(found.mean.is_nan() && found.share == 0.0, "{found:?}");
    }

    #[test]
    fn a_flat_tetrahedron_stays_in_the_range_of_its_voxels() {
        let image = image(|v| v.x);
        let geometry = &image.geometry;
        let at = |x: f64, y: f64, z: f64| geometry.grid_to_world(geometry.index_to_grid(DVec3::new(x, y, z)));
        for height in [0.0, 1e-16, 1e-12, 1e-8] {
            let points = [at(2.2, 1.0, 1.1), at(4.4, 1.0, 1.2), at(3.3, 4.0, 1.3), at(3.3, 2.0, 1.2 + height)];
            let found = overlaps(&image, &points, &ONE)[0];
            assert!(found.share == 1.0 && (2.0..=4.0).contains(&found.mean), "{height}: {found:?}");
        }
    }
}
