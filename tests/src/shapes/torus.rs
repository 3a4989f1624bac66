//! A torus with an exact signed distance, and a bumpy torus whose implicit function is not a
//! distance. The area and volume of the bumpy torus are computed by quadrature.

use crate::scene::{Scene, Truth, off_lattice_centre, shortest_extent};
use crate::shapes::integrate;
use glam::{DVec2, DVec3};
use isoparticles_volume::Geometry;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// A torus around the z axis.
#[derive(Clone, Copy, Debug)]
pub struct Torus {
    /// Centre in mm in the grid frame.
    pub centre: DVec3,
    /// Radius of the centre circle, mm.
    pub ring_radius: f64,
    /// Radius of the tube, mm. It is at most half the ring radius, so it equals the local feature
    /// size.
    pub tube_radius: f64,
}

impl Torus {
    /// Returns a torus with ring and tube radii of 0.27 and 0.13 times [`shortest_extent`].
    pub fn filling(grid: &Geometry) -> Self {
        let extent = shortest_extent(grid);
        Self { centre: off_lattice_centre(grid), ring_radius: 0.27 * extent, tube_radius: 0.13 * extent }
    }
}

impl Scene for Torus {
    fn value(&self, position: DVec3) -> f64 {
        let p = position - self.centre;
        DVec2::new(p.truncate().length() - self.ring_radius, p.z).length() - self.tube_radius
    }

    fn truth(&self) -> Truth {
        let (ring, tube) = (self.ring_radius, self.tube_radius);
        Truth {
            shape: "torus".into(),
            method: "closed form".into(),
            exact_distance: true,
            area: Some(4.0 * PI * PI * ring * tube),
            volume: Some(2.0 * PI * PI * ring * tube * tube),
            components: Some(1),
            genus: Some(1),
            local_feature_size_min: Some(tube),
            local_feature_size_max: Some(tube),
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([("ring_radius".into(), ring), ("tube_radius".into(), tube)]),
            ..Truth::default()
        }
    }
}

/// A torus with the tube radius `tube_radius (1 + amplitude cos(5 u) cos(3 v))`, where `u` runs
/// around the axis and `v` around the tube.
#[derive(Clone, Copy, Debug)]
pub struct BumpyTorus {
    /// The torus without bumps.
    pub torus: Torus,
    /// Amplitude of the bumps as a fraction of the tube radius.
    pub amplitude: f64,
}

impl BumpyTorus {
    /// Returns [`Torus::filling`] with bumps whose amplitude is 15 % of the tube radius.
    pub fn filling(grid: &Geometry) -> Self {
        Self { torus: Torus::filling(grid), amplitude: 0.15 }
    }

    fn tube_radius(&self, u: f64, v: f64) -> f64 {
        self.torus.tube_radius * (1.0 + self.amplitude * (5.0 * u).cos() * (3.0 * v).cos())
    }

    /// Returns the area element: the length of the cross product of the two partial derivatives.
    fn area_element(&self, u: f64, v: f64) -> f64 {
        let tube = self.tube_radius(u, v);
        let bump = self.torus.tube_radius * self.amplitude;
        let tube_u = -5.0 * bump * (5.0 * u).sin() * (3.0 * v).cos();
        let tube_v = -3.0 * bump * (5.0 * u).cos() * (3.0 * v).sin();
        let (sin_v, cos_v) = v.sin_cos();
        // The derivatives of the position with respect to v and u, in cylindrical components
        // (radial, azimuthal, axial).
        let along_v = DVec3::new(tube_v * cos_v - tube * sin_v, 0.0, tube_v * sin_v + tube * cos_v);
        let along_u = DVec3::new(tube_u * cos_v, self.torus.ring_radius + tube * cos_v, tube_u * sin_v);
        along_u.cross(along_v).length()
    }
}

impl Scene for BumpyTorus {
    fn value(&self, position: DVec3) -> f64 {
        let p = position - self.torus.centre;
        let section = DVec2::new(p.truncate().length() - self.torus.ring_radius, p.z);
        section.length() - self.tube_radius(p.y.atan2(p.x), section.y.atan2(section.x))
    }

    fn truth(&self) -> Truth {
        let over_surface =
            |f: &dyn Fn(f64, f64) -> f64| integrate(0.0, 2.0 * PI, 256, |u| integrate(0.0, 2.0 * PI, 256, |v| f(u, v)));
        let volume = over_surface(&|u, v| {
            let tube = self.tube_radius(u, v);
            0.5 * self.torus.ring_radius * tube.powi(2) + tube.powi(3) * v.cos() / 3.0
        });
        Truth {
            shape: "bumpy-torus".into(),
            method: "quadrature of the parametrization".into(),
            exact_distance: false,
            area: Some(over_surface(&|u, v| self.area_element(u, v))),
            volume: Some(volume),
            components: Some(1),
            genus: Some(1),
            centre_grid: self.torus.centre.to_array(),
            dimensions: BTreeMap::from([
                ("ring_radius".into(), self.torus.ring_radius),
                ("tube_radius".into(), self.torus.tube_radius),
                ("bump_height".into(), self.amplitude * self.torus.tube_radius),
            ]),
            ..Truth::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bumps_of_no_height_give_the_torus() {
        let torus = Torus { centre: DVec3::ZERO, ring_radius: 3.0, tube_radius: 1.2 };
        let bumpy = BumpyTorus { torus, amplitude: 0.0 }.truth();
        let plain = torus.truth();
        for (bumpy, plain) in [(bumpy.area, plain.area), (bumpy.volume, plain.volume)] {
            assert!((bumpy.unwrap() / plain.unwrap() - 1.0).abs() < 1e-12);
        }
    }
}
