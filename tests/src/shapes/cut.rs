//! Shapes cut by the border of the volume: a cylinder (cut by two faces of the volume) and a gyroid
//! (cut by all six).

use crate::scene::{Scene, Truth, off_lattice_centre, shortest_extent};
use glam::DVec3;
use isoparticles_volume::Geometry;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// An infinite cylinder along z, cut off by the border of the volume.
#[derive(Clone, Copy, Debug)]
pub struct Cylinder {
    /// A point on the axis, in mm in the grid frame.
    pub centre: DVec3,
    /// Radius, mm.
    pub radius: f64,
    /// Length, mm. The cylinder extends half a voxel beyond the lowest and the highest voxel
    /// centres.
    pub length: f64,
}

impl Cylinder {
    /// Returns a cylinder with a radius of 0.28 times [`shortest_extent`].
    pub fn filling(grid: &Geometry) -> Self {
        Self {
            centre: off_lattice_centre(grid),
            radius: 0.28 * shortest_extent(grid),
            length: grid.upper_corner().z + grid.spacing.z,
        }
    }
}

impl Scene for Cylinder {
    fn value(&self, position: DVec3) -> f64 {
        (position - self.centre).truncate().length() - self.radius
    }

    fn truth(&self) -> Truth {
        let (radius, length) = (self.radius, self.length);
        Truth {
            shape: "cylinder".into(),
            method: "closed form, with flat caps half a voxel past the outermost voxel centres".into(),
            exact_distance: true,
            area: Some(2.0 * PI * radius * (length + radius)),
            volume: Some(PI * radius * radius * length),
            components: Some(1),
            genus: Some(0),
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([("radius".into(), radius), ("length".into(), length)]),
            ..Truth::default()
        }
    }
}

/// The gyroid `sin x cos y + sin y cos z + sin z cos x < 0`.
#[derive(Clone, Copy, Debug)]
pub struct Gyroid {
    /// Origin of the phase, in mm in the grid frame.
    pub centre: DVec3,
    /// Length of one period, mm.
    pub period: f64,
}

impl Gyroid {
    /// Returns a gyroid whose period is half of [`shortest_extent`].
    pub fn filling(grid: &Geometry) -> Self {
        Self { centre: off_lattice_centre(grid), period: 0.5 * shortest_extent(grid) }
    }
}

impl Scene for Gyroid {
    fn value(&self, position: DVec3) -> f64 {
        let scale = 2.0 * PI / self.period;
        let p = scale * (position - self.centre);
        let (x, y, z) = (p.x, p.y, p.z);
        // On the surface, the gradient with respect to the phase has a magnitude of about 1.5.
        // Dividing by this value gives an approximate distance.
        (x.sin() * y.cos() + y.sin() * z.cos() + z.sin() * x.cos()) / (1.5 * scale)
    }

    fn truth(&self) -> Truth {
        Truth {
            shape: "gyroid".into(),
            method: "components and genus are not stated: the cut by the border decides them".into(),
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([("period".into(), self.period)]),
            ..Truth::default()
        }
    }
}
