//! Measures the surfaces of objects in a voxel grid: their area, and their local shape at sampled
//! faces.
//!
//! A *face* separates two neighbouring voxels of different classes. Parallel lines along axis a,
//! one per area s, cross a surface |n_a| A / s times, where A is the area of the surface and n is
//! its unit normal. Averaged over all directions, |n_x| + |n_y| + |n_z| is 3/2 (Cauchy and
//! Crofton). The area of the surface is therefore 2/3 of the total area of all faces.
//!
//! A ball is centred at each sampled face. The fraction of its volume inside the object gives the
//! mean curvature H (integral invariant of Pottmann et al. 2007: fraction = 1/2 - 3/16 r H), and
//! the centroid of the part inside gives the normal. Walks along the normal in both directions
//! measure the thickness of the object and of the adjacent gap.

use crate::classes::{Classes, OUTSIDE};
use glam::DVec3;
use isoparticles_field::random::uniform;
use isoparticles_volume::Geometry;
use rayon::prelude::*;

/// Radius of the ball in units of the mean spacing. In a smaller ball, the voxel staircase changes
/// the volume fraction more than the curvature does. The value comes from the grid search described
/// at `EDGE_OVER_RADIUS` in `cost.rs`.
pub const BALL: f64 = 2.0;

/// Step length along the normal in units of the mean spacing. It is also the resolution of the
/// thickness. With two steps per voxel, the walk does not skip a layer one voxel thick.
const WALK_STEP: f64 = 0.5;

/// Maximum length of a walk along the normal in units of the mean spacing. A part 30 voxels thick
/// limits h to 0.20 x 30 = 6 voxels (`EDGE_OVER_THICKNESS` in `cost.rs`). The vertex density is
/// proportional to 1 / h^2, so thicker parts have at most (0.75 / 6)^2 = 1/64 of the density at the
/// minimum h. Their exact thickness hardly affects the vertex count.
const WALK_LENGTH: f64 = 30.0;

/// Seed for the random selection of faces. The value is arbitrary.
const SEED: u64 = 1;

/// The surface of one class.
#[derive(Clone, Debug, Default)]
pub struct Boundary {
    /// Number of faces normal to each axis, including those at the border of the volume.
    pub faces: [usize; 3],
    /// The sampled faces.
    pub sample: Vec<SampledFace>,
    /// Number of faces that one sampled face represents.
    pub weight: f64,
}

/// A sampled face.
#[derive(Clone, Copy, Debug)]
pub struct SampledFace {
    /// Axis normal to the face.
    pub axis: usize,
    /// Centre of the face in mm, in the grid frame.
    pub position: DVec3,
    /// Absolute difference between 1/2 and the fraction of the ball's volume inside the object.
    pub imbalance: f64,
    /// Distance along the normal to the far side of the object or of the adjacent gap, whichever is
    /// smaller, in units of the mean spacing. Infinite if both distances exceed `WALK_LENGTH`.
    pub thickness: f64,
}

/// A face between a voxel of `class` and a voxel of another class.
struct Face {
    class: u16,
    /// Index of the voxel of `class`.
    inside: [usize; 3],
    /// Axis normal to the face.
    axis: usize,
    /// Whether the face is on the upper side of the voxel `inside` along the axis.
    is_up: bool,
}

impl Boundary {
    /// Returns the area of the surface in mm^2.
    pub fn area(&self, geometry: &Geometry) -> f64 {
        (0..3).map(|axis| self.faces[axis] as f64 * face_area(geometry, axis)).sum::<f64>() / 1.5
    }

    /// Returns the surface area that a sampled face represents, in mm^2.
    pub fn area_of(&self, place: &SampledFace, geometry: &Geometry) -> f64 {
        self.weight * face_area(geometry, place.axis) / 1.5
    }

    /// Returns the length of the diagonal of the bounding box of the sampled faces, in mm.
    pub fn diagonal(&self) -> f64 {
        self.extent().length()
    }

    /// Returns the edge lengths of the bounding box of the sampled faces, in mm.
    pub fn extent(&self) -> DVec3 {
        let low = self.sample.iter().fold(DVec3::INFINITY, |low, place| low.min(place.position));
        let high = self.sample.iter().fold(DVec3::NEG_INFINITY, |high, place| high.max(place.position));
        (high - low).max(DVec3::ZERO)
    }
}

/// Returns the area of a face normal to `axis`, in mm^2.
fn face_area(geometry: &Geometry, axis: usize) -> f64 {
    geometry.spacing.element_product() / geometry.spacing[axis]
}

/// Returns the surface of each class except [`OUTSIDE`], with about `wanted` sampled faces per
/// class.
pub fn boundaries(classes: &Classes<'_>, wanted: usize) -> Vec<Boundary> {
    let geometry = classes.geometry;
    let nz = geometry.size[2];
    let count = |k: usize| {
        let mut faces = vec![[0usize; 3]; classes.count + 1];
        each_face(classes, k, |face| faces[usize::from(face.class)][face.axis] += 1);
        faces
    };
    let add = |mut a: Vec<[usize; 3]>, b: Vec<[usize; 3]>| {
        a.iter_mut().zip(b).for_each(|(a, b)| a.iter_mut().zip(b).for_each(|(a, b)| *a += b));
        a
    };
    let faces = (0..nz).into_par_iter().map(count).reduce(|| vec![[0; 3]; classes.count + 1], add);
    let share: Vec<f64> = faces.iter().map(|faces| wanted as f64 / faces.iter().sum::<usize>().max(1) as f64).collect();
    let shapes = Shapes::new(geometry);
    let draw = |k: usize| {
        let mut drawn: Vec<(u16, SampledFace)> = Vec::new();
        each_face(classes, k, |face| {
            let [i, j, k] = face.inside;
            let counter = 6 * geometry.linear(i, j, k) + 2 * face.axis + usize::from(face.is_up);
            if uniform(SEED, 0, counter as u64) < share[usize::from(face.class)] {
                drawn.push((face.class, shapes.place(classes, &face)));
            }
        });
        drawn
    };
    let slices: Vec<Vec<(u16, SampledFace)>> = (0..nz).into_par_iter().map(draw).collect();
    let mut found: Vec<Boundary> = faces.iter().map(|&faces| Boundary { faces, ..Boundary::default() }).collect();
    for (class, place) in slices.into_iter().flatten() {
        found[usize::from(class)].sample.push(place);
    }
    for boundary in &mut found {
        boundary.weight = boundary.faces.iter().sum::<usize>() as f64 / boundary.sample.len().max(1) as f64;
    }
    found.split_off(1)
}

/// Calls `found` for each face between a voxel of slice `k` and the next voxel along an axis, and
/// for each face of the slice at a lower border of the volume.
fn each_face(classes: &Classes<'_>, k: usize, mut found: impl FnMut(Face)) {
    let [nx, ny, nz] = classes.geometry.size;
    let row = |j: usize, k: usize| {
        let mut row = vec![OUTSIDE; nx];
        if j < ny && k < nz {
            classes.copy_row(j, k, &mut row);
        }
        row
    };
    let beyond = vec![OUTSIDE; nx];
    let mut own = row(0, k);
    for j in 0..ny {
        let next = row(j + 1, k);
        let above = row(j, k + 1);
        let mut pair = |low: u16, high: u16, [i, j, k]: [usize; 3], axis: usize| {
            if low != OUTSIDE {
                found(Face { class: low, inside: [i, j, k], axis, is_up: true });
            }
            if high != OUTSIDE {
                let mut inside = [i, j, k];
                inside[axis] += 1;
                found(Face { class: high, inside, axis, is_up: false });
            }
        };
        for i in 0..nx {
            let right = if i + 1 < nx { own[i + 1] } else { OUTSIDE };
            if own[i] != right {
                pair(own[i], right, [i, j, k], 0);
            }
        }
        for (other, axis) in [(&next, 1), (&above, 2)] {
            if own != *other {
                for i in (0..nx).filter(|&i| own[i] != other[i]) {
                    pair(own[i], other[i], [i, j, k], axis);
                }
            }
        }
        // faces at the lower border along each axis
        let mut border = |i: usize, class: u16, axis: usize| {
            if class != OUTSIDE {
                found(Face { class, inside: [i, j, k], axis, is_up: false });
            }
        };
        border(0, own[0], 0);
        for (is_border, axis) in [(j == 0, 1), (k == 0, 2)] {
            if is_border && own != beyond {
                own.iter().enumerate().for_each(|(i, &class)| border(i, class, axis));
            }
        }
        own = next;
    }
}

/// The balls used to measure the shape at a face.
struct Shapes {
    /// Offsets from the inside voxel of a face to all voxels in the ball around the face. The first
    /// index is the axis of the face. The second is 1 if the face is on the upper side of the
    /// inside voxel.
    balls: [[Vec<[isize; 3]>; 2]; 3],
}

impl Shapes {
    fn new(geometry: &Geometry) -> Self {
        let radius = BALL * geometry.mean_spacing();
        let reach = geometry.spacing.to_array().map(|s| (radius / s).ceil() as isize + 1);
        let ball = |axis: usize, is_up: bool| {
            let mut centre = DVec3::ZERO;
            centre[axis] = if is_up { 0.5 } else { -0.5 };
            let mut offsets = Vec::new();
            for z in -reach[2]..=reach[2] {
                for y in -reach[1]..=reach[1] {
                    for x in -reach[0]..=reach[0] {
                        let offset = DVec3::new(x as f64, y as f64, z as f64);
                        if ((offset - centre) * geometry.spacing).length() <= radius {
                            offsets.push([x, y, z]);
                        }
                    }
                }
            }
            offsets
        };
        Self { balls: [0, 1, 2].map(|axis| [false, true].map(|is_up| ball(axis, is_up))) }
    }

    fn place(&self, classes: &Classes<'_>, face: &Face) -> SampledFace {
        let geometry = classes.geometry;
        let size = geometry.size;
        let is_own = |index: [isize; 3]| {
            let within = |a: usize| usize::try_from(index[a]).ok().filter(|n| *n < size[a]);
            within(0).zip(within(1)).zip(within(2)).is_some_and(|((i, j), k)| classes.at([i, j, k]) == face.class)
        };
        let inside = face.inside.map(|n| n as isize);
        let mut centre = DVec3::from_array(face.inside.map(|n| n as f64));
        centre[face.axis] += if face.is_up { 0.5 } else { -0.5 };
        let ball = &self.balls[face.axis][usize::from(face.is_up)];
        let (mut own, mut mass) = (0usize, DVec3::ZERO);
        for offset in ball {
            let index = [0, 1, 2].map(|a| inside[a] + offset[a]);
            if is_own(index) {
                own += 1;
                mass += DVec3::from_array(index.map(|n| n as f64)) - centre;
            }
        }
        let position = geometry.index_to_grid(centre);
        let imbalance = if ball.is_empty() { 0.0 } else { (own as f64 / ball.len() as f64 - 0.5).abs() };
        let outward = -(mass * geometry.spacing).normalize_or_zero();
        let voxel = geometry.mean_spacing();
        let walk = |direction: DVec3, from_inside: bool| {
            let steps = (WALK_LENGTH / WALK_STEP) as usize;
            // the first sample is 0.75 voxels away, because a closer one may be on the wrong side
            // of the staircase
            let ways = (1..=steps).map(|n| (n as f64 + 0.5) * WALK_STEP);
            let ends = |way: &f64| {
                let index = geometry.grid_to_index(position + direction * (way * voxel));
                is_own(index.to_array().map(|n| n.round() as isize)) != from_inside
            };
            if direction == DVec3::ZERO { f64::INFINITY } else { ways.into_iter().find(ends).unwrap_or(f64::INFINITY) }
        };
        let thickness = walk(-outward, true).min(walk(outward, false));
        SampledFace { axis: face.axis, position, imbalance, thickness }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::classes::Rule;
    use isoparticles_volume::{Image, Voxels};
    use std::f64::consts::PI;

    fn boundary(geometry: &Geometry, inside: impl Fn(DVec3) -> bool, wanted: usize) -> Boundary {
        let image = Image::sampled(geometry.clone(), |p| u8::from(inside(p)));
        let voxels = Voxels::U8(image.data);
        boundaries(&Classes::new(geometry, vec![(&voxels, Rule::any_of(&[1]))], 1), wanted).remove(0)
    }

    #[test]
    fn the_area_and_the_curvature_of_a_ball_are_its_own() {
        let geometry = Geometry::axis_aligned([60, 60, 30], DVec3::new(0.5, 0.5, 1.0));
        let centre = 0.5 * geometry.upper_corner();
        let radius = 11.3;
        let ball = boundary(&geometry, |p| p.distance(centre) < radius, 3000);
        let area = ball.area(&geometry);
        assert!((area / (4.0 * PI * radius * radius) - 1.0).abs() < 0.03, "{area}");
        assert!((2500..3500).contains(&ball.sample.len()), "{}", ball.sample.len());
        let sampled: f64 = ball.sample.iter().map(|place| ball.area_of(place, &geometry)).sum();
        assert!((sampled / area - 1.0).abs() < 0.05, "{sampled}, not {area}");
        assert!((ball.diagonal() - 2.0 * 3f64.sqrt() * radius).abs() < 1.5, "{}", ball.diagonal());
        // the opposite side is 2 r = 36 mean spacings away, beyond the end of the walk
        assert!(ball.sample.iter().all(|place| place.thickness > 15.0), "a walk along the normal ends early");
    }

    #[test]
    fn plates_have_their_thickness_and_the_border_counts() {
        let geometry = Geometry::axis_aligned([20, 20, 24], DVec3::ONE);
        let plate = boundary(&geometry, |p| (10.0..14.0).contains(&p.z), usize::MAX);
        assert_eq!(plate.faces, [2 * 20 * 4, 2 * 20 * 4, 2 * 20 * 20]);
        let is_inner =
            |place: &&SampledFace| (5.0..15.0).contains(&place.position.x) && (5.0..15.0).contains(&place.position.y);
        for place in plate.sample.iter().filter(|place| place.axis == 2).filter(is_inner) {
            assert!((place.thickness - 4.0).abs() <= 0.5, "{place:?}");
            assert!(place.imbalance < 1e-9, "{place:?}");
        }
        let cut = boundary(&geometry, |p| p.x > 15.5, usize::MAX);
        assert_eq!(cut.faces, [2 * 20 * 24, 2 * 4 * 24, 2 * 4 * 20]);
    }
}
