//! Checks the sizes and the geometry given in a file header.

use crate::error::{Error, Result, bad};
use crate::geometry::{Geometry, Space};
use glam::{DMat3, DVec3};
use std::ops::RangeInclusive;
use std::path::Path;

/// Accepted voxel lengths in mm. Outside this range, rounding errors affect the results.
const SPACINGS: RangeInclusive<f64> = 1e-9..=1e6;

/// Returns the number of voxels of a grid, given the sizes in a file header. Fails if a size is
/// zero or if the product overflows.
pub(crate) fn voxel_count(path: &Path, size: [usize; 3]) -> Result<usize> {
    if size.contains(&0) {
        return Err(bad(path, format!("a size is zero: {size:?}"), "there are no voxels", "write the file again"));
    }
    size.iter().try_fold(1usize, |count, &n| count.checked_mul(n)).ok_or_else(|| {
        let what = format!("its header declares {} x {} x {} voxels", size[0], size[1], size[2]);
        bad(path, what, "this is more than a computer can address", "write the file again; its header is damaged")
    })
}

/// Returns the spacing that the user gave for a file without one.
///
/// # Errors
/// If there is none, or if it is not from 1e-9 to 1e6 mm.
pub(crate) fn checked_spacing(path: &Path, given: Option<DVec3>) -> Result<DVec3> {
    match given {
        Some(spacing) if (0..3).all(|axis| SPACINGS.contains(&spacing[axis])) => Ok(spacing),
        Some(spacing) => Err(bad(
            path,
            format!("the spacing {} x {} x {} mm was given", spacing.x, spacing.y, spacing.z),
            "voxels must be from 1e-9 mm to 1e6 mm long",
            "correct the spacing",
        )),
        None => Err(no_spacing(path, "does not contain the spacing of its voxels")),
    }
}

/// Creates the error for a file whose spacing is missing or incomplete.
pub(crate) fn no_spacing(path: &Path, what: impl std::fmt::Display) -> Error {
    bad(
        path,
        what,
        "the size of the mesh depends on it",
        "give the distances between voxel centres along x, y and z in mm: --spacing 0.01,0.01,0.02, or for make \
         SPACING=0.01,0.01,0.02; convert a mask to a format that contains them, such as NRRD",
    )
}

/// Creates a geometry from the world vectors between neighbouring voxels along the three axes.
///
/// # Errors
/// If a spacing is not between 1e-9 and 1e6 mm, if a coordinate of the origin is not finite or
/// exceeds 1e9 mm, or if the axes are (nearly) coplanar.
pub(crate) fn geometry_from_steps(
    path: &Path,
    size: [usize; 3],
    steps: [DVec3; 3],
    origin: DVec3,
    space: Space,
) -> Result<Geometry> {
    let spacing = DVec3::from_array(steps.map(|step| step.length()));
    if let Some(axis) = (0..3).find(|&axis| !(spacing[axis] > 0.0 && spacing[axis].is_finite())) {
        return Err(bad(
            path,
            format!("the spacing of axis {axis} is {}", spacing[axis]),
            "the spacing must be a finite positive number",
            "correct the spacing in the file's header",
        ));
    }
    if let Some(axis) = (0..3).find(|&axis| !SPACINGS.contains(&spacing[axis])) {
        return Err(bad(
            path,
            format!("the spacing of axis {axis} is {:e}", spacing[axis]),
            "voxels must be from 1e-9 mm to 1e6 mm long; beyond that, results suffer from rounding",
            "correct the spacing in the file's header",
        ));
    }
    // at 1e9 mm, adjacent f64 values differ by 1.2e-7 mm
    if !origin.is_finite() || origin.abs().max_element() > 1e9 {
        return Err(bad(
            path,
            format!("the origin is {origin}"),
            "world coordinates need a finite origin within 1e9 mm",
            "correct the origin in the file's header",
        ));
    }
    let directions = DMat3::from_cols(steps[0] / spacing.x, steps[1] / spacing.y, steps[2] / spacing.z);
    // The determinant is 1e-3 if two axes are perpendicular and the third is 0.06 degrees out of
    // their plane.
    if directions.determinant().abs() < 1e-3 {
        return Err(bad(
            path,
            format!("the axes {}, {} and {} are (nearly) coplanar", steps[0], steps[1], steps[2]),
            "the volume would be flat",
            "correct the directions in the file's header",
        ));
    }
    Ok(Geometry { size, spacing, directions, origin, space })
}

/// Fails if a spacing is given for a file that contains one.
pub(crate) fn without_spacing(path: &Path, spacing: Option<DVec3>) -> Result<()> {
    match spacing {
        Some(spacing) => Err(bad(
            path,
            format!(
                "contains the spacing of its voxels, and {} x {} x {} mm was given",
                spacing.x, spacing.y, spacing.z
            ),
            "a second spacing would contradict that of the file",
            "leave out the spacing; if that of the file is wrong, correct the file, for example with 3D Slicer",
        )),
        None => Ok(()),
    }
}
