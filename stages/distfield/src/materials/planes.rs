//! Planes of the faces of the volume, and the parts of voxels before planes.

use glam::DVec3;
use isoparticles_field::materials::Bound;

/// Returns the plane of a face of the volume: the last or the first along an axis, at `position`
/// (grid frame, mm). Its name is x0, x1, y0, y1, z0 or z1.
pub(super) fn face_plane(axis: usize, is_last: bool, position: f64) -> Bound {
    Bound {
        name: format!("{}{}", ["x", "y", "z"][axis], u8::from(is_last)),
        point: DVec3::AXES[axis] * position,
        normal: if is_last { DVec3::AXES[axis] } else { -DVec3::AXES[axis] },
    }
}

/// Returns the fraction of a voxel that the planes leave. The fraction for one plane is exact if
/// the normal is an axis of the grid; otherwise its errors cancel on average. The fractions for
/// several planes are multiplied, which is exact if these planes are perpendicular.
pub(super) fn fraction_left(bounds: &[Bound], centre: DVec3, spacing: DVec3) -> f64 {
    let left = |bound: &Bound| (0.5 - bound.distance(centre) / bound.normal.abs().dot(spacing)).clamp(0.0, 1.0);
    bounds.iter().map(left).product()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fractions_of_voxels_sum_to_the_volume_that_a_plane_leaves() {
        let spacing = DVec3::new(1.0, 0.5, 2.0);
        let bound = |normal: DVec3, at: f64| {
            let normal = normal.normalize();
            [Bound { name: String::new(), point: DVec3::new(10.0, 5.0, 20.0) + at * normal, normal }]
        };
        let sum = |bounds: &[Bound]| -> f64 {
            let centres = (0..8000).map(|n| DVec3::new((n % 20) as f64, (n / 20 % 20) as f64, (n / 400) as f64) + 0.5);
            centres.map(|at| fraction_left(bounds, at * spacing, spacing)).sum()
        };
        assert!((sum(&bound(DVec3::X, 0.3)) - 8000.0 * 10.3 / 20.0).abs() < 1e-9);
        assert!((sum(&bound(DVec3::new(1.0, 2.0, 0.5), 0.0)) / 4000.0 - 1.0).abs() < 1e-3);
    }
}
