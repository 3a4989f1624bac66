//! Ball, ellipsoid, thin shell and two balls, with exact signed distances.

use crate::scene::{Scene, Truth, off_lattice_centre, shortest_extent};
use crate::shapes::integrate;
use glam::DVec3;
use isoparticles_volume::Geometry;
use std::collections::BTreeMap;
use std::f64::consts::PI;

/// A ball.
#[derive(Clone, Copy, Debug)]
pub struct Ball {
    /// Centre in mm in the grid frame.
    pub centre: DVec3,
    /// Radius, mm.
    pub radius: f64,
}

impl Ball {
    /// Returns a ball with a radius of 0.35 times [`shortest_extent`].
    pub fn filling(grid: &Geometry) -> Self {
        Self { centre: off_lattice_centre(grid), radius: 0.35 * shortest_extent(grid) }
    }
}

impl Scene for Ball {
    fn value(&self, position: DVec3) -> f64 {
        position.distance(self.centre) - self.radius
    }

    fn truth(&self) -> Truth {
        Truth {
            shape: "ball".into(),
            method: "closed form".into(),
            exact_distance: true,
            area: Some(4.0 * PI * self.radius.powi(2)),
            volume: Some(4.0 / 3.0 * PI * self.radius.powi(3)),
            components: Some(1),
            genus: Some(0),
            local_feature_size_min: Some(self.radius),
            local_feature_size_max: Some(self.radius),
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([("radius".into(), self.radius)]),
            ..Truth::default()
        }
    }
}

/// An ellipsoid aligned with the grid axes, with its longest axis along x.
#[derive(Clone, Copy, Debug)]
pub struct Ellipsoid {
    /// Centre in mm in the grid frame.
    pub centre: DVec3,
    /// Semi-axes in mm, in descending order.
    pub semi_axes: DVec3,
}

impl Ellipsoid {
    /// Returns an ellipsoid with semi-axes of 0.40, 0.30 and 0.24 times [`shortest_extent`].
    pub fn filling(grid: &Geometry) -> Self {
        let extent = shortest_extent(grid);
        Self { centre: off_lattice_centre(grid), semi_axes: extent * DVec3::new(0.40, 0.30, 0.24) }
    }

    /// Returns the surface area in mm^2 by two-dimensional quadrature of the parametrized surface.
    fn area(&self) -> f64 {
        let [a, b, c] = self.semi_axes.to_array();
        integrate(0.0, PI, 2000, |polar| {
            let (sin_polar, cos_polar) = polar.sin_cos();
            integrate(0.0, 2.0 * PI, 256, |azimuth| {
                let (sin_azimuth, cos_azimuth) = azimuth.sin_cos();
                let normal =
                    DVec3::new(b * c * sin_polar * cos_azimuth, a * c * sin_polar * sin_azimuth, a * b * cos_polar);
                sin_polar * normal.length()
            })
        })
    }
}

impl Scene for Ellipsoid {
    /// Returns the signed distance to the foot point `q_i = a_i^2 p_i / (t + a_i^2)`, where `p` is
    /// the position relative to the centre and `a` are the semi-axes. `t` is the largest root of
    /// `sum (a_i p_i / (t + a_i^2))^2 = 1`. The sum decreases monotonically in the bracket, so
    /// bisection always finds the root.
    fn value(&self, position: DVec3) -> f64 {
        let p = (position - self.centre).abs();
        let axes = self.semi_axes;
        let squared = axes * axes;
        let excess = |t: f64| ((axes * p) / (squared + DVec3::splat(t))).length_squared() - 1.0;
        let inside = (p / axes).length_squared() < 1.0;
        let mut low = -squared.min_element();
        let mut high = axes.max_element() * p.length().max(1e-12);
        if excess(low + 1e-12 * squared.min_element()) <= 0.0 {
            // The bracket contains no root only if the position is on the medial axis inside the
            // ellipsoid, where p.z is zero. The formula then gives x and y of the foot point, and
            // the ellipsoid's equation gives z.
            let t = low;
            let mut foot = DVec3::new(squared.x * p.x / (t + squared.x), squared.y * p.y / (t + squared.y), 0.0);
            let rest = 1.0 - (foot / axes).length_squared();
            foot.z = axes.z * rest.max(0.0).sqrt();
            return -p.distance(foot);
        }
        for _ in 0..80 {
            let middle = 0.5 * (low + high);
            if excess(middle) > 0.0 {
                low = middle;
            } else {
                high = middle;
            }
        }
        let foot = squared * p / (squared + DVec3::splat(0.5 * (low + high)));
        let distance = p.distance(foot);
        if inside { -distance } else { distance }
    }

    fn truth(&self) -> Truth {
        let [a, b, c] = self.semi_axes.to_array();
        Truth {
            shape: "ellipsoid".into(),
            method: "closed form; area by quadrature of the parametrization".into(),
            exact_distance: true,
            area: Some(self.area()),
            volume: Some(4.0 / 3.0 * PI * a * b * c),
            components: Some(1),
            genus: Some(0),
            // The medial axis is a flat region in the x-y plane. It ends at the centres of
            // curvature of the tips of the long axis, c^2 / a from the tips. The distance from the
            // poles of the short axis to this region is c.
            local_feature_size_min: Some(c * c / a),
            local_feature_size_max: Some(c),
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([
                ("semi_axis_x".into(), a),
                ("semi_axis_y".into(), b),
                ("semi_axis_z".into(), c),
            ]),
            ..Truth::default()
        }
    }
}

/// A hollow ball.
#[derive(Clone, Copy, Debug)]
pub struct ThinShell {
    /// Centre in mm in the grid frame.
    pub centre: DVec3,
    /// Radius of the mid-surface of the wall, mm.
    pub radius: f64,
    /// Thickness of the wall, mm.
    pub thickness: f64,
}

impl ThinShell {
    /// Returns a shell whose mid-surface has a radius of 0.35 times [`shortest_extent`].
    pub fn filling(grid: &Geometry, thickness: f64) -> Self {
        Self { centre: off_lattice_centre(grid), radius: 0.35 * shortest_extent(grid), thickness }
    }
}

impl Scene for ThinShell {
    fn value(&self, position: DVec3) -> f64 {
        (position.distance(self.centre) - self.radius).abs() - 0.5 * self.thickness
    }

    fn truth(&self) -> Truth {
        let (outer, inner) = (self.radius + 0.5 * self.thickness, self.radius - 0.5 * self.thickness);
        Truth {
            shape: "thin-shell".into(),
            method: "closed form".into(),
            exact_distance: true,
            area: Some(4.0 * PI * (outer.powi(2) + inner.powi(2))),
            volume: Some(4.0 / 3.0 * PI * (outer.powi(3) - inner.powi(3))),
            components: Some(2),
            genus: Some(0),
            local_feature_size_min: Some(0.5 * self.thickness),
            local_feature_size_max: Some(0.5 * self.thickness),
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([
                ("outer_radius".into(), outer),
                ("inner_radius".into(), inner),
                ("thickness".into(), self.thickness),
            ]),
            ..Truth::default()
        }
    }
}

/// Two equal balls along x.
#[derive(Clone, Copy, Debug)]
pub struct TwoBalls {
    /// Middle of the gap, in mm in the grid frame.
    pub centre: DVec3,
    /// Radius of each ball, mm.
    pub radius: f64,
    /// Distance between the two surfaces, mm.
    pub gap: f64,
}

impl TwoBalls {
    /// Returns two balls that together span 0.84 times [`shortest_extent`].
    pub fn filling(grid: &Geometry, gap: f64) -> Self {
        let radius = 0.25 * (0.84 * shortest_extent(grid) - gap);
        Self { centre: off_lattice_centre(grid), radius, gap }
    }
}

impl Scene for TwoBalls {
    fn value(&self, position: DVec3) -> f64 {
        let mut p = position - self.centre;
        p.x = p.x.abs() - self.radius - 0.5 * self.gap;
        p.length() - self.radius
    }

    fn truth(&self) -> Truth {
        Truth {
            shape: "two-balls".into(),
            method:
                "closed form; a point's local feature size is the smaller of radius and distance to the middle plane"
                    .into(),
            exact_distance: true,
            area: Some(8.0 * PI * self.radius.powi(2)),
            volume: Some(8.0 / 3.0 * PI * self.radius.powi(3)),
            components: Some(2),
            genus: Some(0),
            local_feature_size_min: Some(self.radius.min(0.5 * self.gap)),
            local_feature_size_max: Some(self.radius),
            centre_grid: self.centre.to_array(),
            dimensions: BTreeMap::from([("radius".into(), self.radius), ("gap".into(), self.gap)]),
            ..Truth::default()
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ellipsoid_distance_has_unit_gradient_and_the_right_sign() {
        let shape = Ellipsoid { centre: DVec3::ZERO, semi_axes: DVec3::new(4.0, 3.0, 2.0) };
        assert!((shape.value(DVec3::new(5.5, 0.0, 0.0)) - 1.5).abs() < 1e-9);
        assert!((shape.value(DVec3::new(0.0, 0.0, 0.0)) + 2.0).abs() < 1e-6);
        assert!((shape.value(DVec3::new(0.0, 0.0, 1.0)) + 1.0).abs() < 1e-9);
        let step = 1e-5;
        for p in [DVec3::new(3.0, 2.0, 1.5), DVec3::new(-1.0, 2.5, 0.7), DVec3::new(0.4, -0.3, 1.2)] {
            let gradient = DVec3::from_array(
                [DVec3::X, DVec3::Y, DVec3::Z]
                    .map(|e| (shape.value(p + step * e) - shape.value(p - step * e)) / (2.0 * step)),
            );
            assert!((gradient.length() - 1.0).abs() < 1e-5, "gradient {gradient} at {p}");
        }
    }

    #[test]
    fn ellipsoid_area_matches_the_sphere_and_the_spheroid() {
        let sphere = Ellipsoid { centre: DVec3::ZERO, semi_axes: DVec3::splat(2.0) };
        assert!((sphere.area() / (16.0 * PI) - 1.0).abs() < 1e-6);
        let (a, c) = (3.0_f64, 2.0_f64);
        // The area of an oblate spheroid has a closed form.
        let eccentricity = (1.0 - c * c / (a * a)).sqrt();
        let exact = 2.0 * PI * a * a * (1.0 + (1.0 - eccentricity.powi(2)) / eccentricity * eccentricity.atanh());
        let spheroid = Ellipsoid { centre: DVec3::ZERO, semi_axes: DVec3::new(a, a, c) };
        assert!((spheroid.area() / exact - 1.0).abs() < 1e-6);
    }
}
