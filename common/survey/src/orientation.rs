//! Describes the directions of a volume's axes.

use glam::DVec3;
use isoparticles_volume::{Geometry, Space};
use serde::Serialize;

/// Orientation of a grid in the world.
#[derive(Clone, Debug, Serialize)]
pub struct Orientation {
    /// Direction of each axis, from its first voxel to its last. Examples: `right to left`, or `+x`
    /// if the file does not specify an anatomical space.
    pub axes: [String; 3],
    /// Initials of the axis directions, for example `LPS`. `None` if the file does not specify an
    /// anatomical space.
    pub letters: Option<String>,
    /// Maximum angle between a grid axis and the nearest world axis, in degrees.
    pub oblique_degrees: f64,
    /// Whether the transformation from grid to world includes a reflection.
    pub left_handed: bool,
    /// Whether two grid axes form an angle that deviates from 90 degrees by more than 0.1 degrees.
    pub sheared: bool,
}

/// Names of the negative and the positive end of each axis of the LPS frame.
const ENDS: [[&str; 2]; 3] = [["right", "left"], ["anterior", "posterior"], ["inferior", "superior"]];

impl Orientation {
    /// Determines the orientation of a grid.
    pub fn of(geometry: &Geometry) -> Self {
        let geometry = geometry.clone().in_space(Space::Lps);
        let directions = [0, 1, 2].map(|axis| geometry.directions.col(axis));
        let nearest = directions.map(nearest_axis);
        let is_named = geometry.space == Space::Lps;
        let axes = [0, 1, 2].map(|n| {
            let axis = nearest[n];
            let is_along = directions[n][axis] > 0.0;
            match (is_named, is_along) {
                (true, true) => format!("{} to {}", ENDS[axis][0], ENDS[axis][1]),
                (true, false) => format!("{} to {}", ENDS[axis][1], ENDS[axis][0]),
                (false, _) => format!("{}{}", if is_along { "+" } else { "-" }, ["x", "y", "z"][axis]),
            }
        });
        let letter = |n: usize| ENDS[nearest[n]][usize::from(directions[n][nearest[n]] > 0.0)][..1].to_uppercase();
        let angle = |n: usize| directions[n][nearest[n]].abs().min(1.0).acos().to_degrees();
        let pairs = [(0, 1), (1, 2), (2, 0)];
        let shear = pairs.map(|(a, b)| directions[a].dot(directions[b]).abs()).into_iter().fold(0.0, f64::max);
        Self {
            axes,
            letters: is_named.then(|| [0, 1, 2].map(letter).concat()),
            oblique_degrees: [0, 1, 2].map(angle).into_iter().fold(0.0, f64::max),
            left_handed: geometry.is_left_handed(),
            sheared: shear > 0.1f64.to_radians().sin(),
        }
    }
}

fn nearest_axis(direction: DVec3) -> usize {
    (0..3).max_by(|&a, &b| direction[a].abs().total_cmp(&direction[b].abs())).unwrap_or(0)
}

#[cfg(test)]
mod tests {
    use super::*;
    use glam::DMat3;

    #[test]
    fn axes_are_named_by_where_they_point() {
        let geometry = Geometry { space: Space::Lps, ..Geometry::axis_aligned([2, 2, 2], DVec3::ONE) };
        let plain = Orientation::of(&geometry);
        assert_eq!(plain.axes, ["right to left", "anterior to posterior", "inferior to superior"]);
        assert_eq!((plain.letters.as_deref(), plain.left_handed, plain.oblique_degrees), (Some("LPS"), false, 0.0));

        // axes pointing right, anterior and inferior, rotated by 20 degrees about the z axis
        let (sine, cosine) = 20f64.to_radians().sin_cos();
        let directions = DMat3::from_cols(DVec3::new(-cosine, -sine, 0.0), DVec3::new(sine, -cosine, 0.0), -DVec3::Z);
        let turned = Orientation::of(&Geometry { directions, ..geometry.clone() });
        assert_eq!(turned.letters.as_deref(), Some("RAI"));
        assert_eq!(turned.axes[2], "superior to inferior");
        assert!(turned.left_handed && !turned.sheared);
        assert!((turned.oblique_degrees - 20.0).abs() < 1e-9);

        let same = Geometry { directions, ..geometry.clone() }.in_space(Space::Ras);
        assert_eq!(Orientation::of(&same).letters.as_deref(), Some("RAI"), "in the other frame");

        let unnamed = Orientation::of(&Geometry { space: Space::Unnamed, directions, ..geometry });
        assert_eq!((unnamed.axes, unnamed.letters), (["-x".into(), "-y".into(), "-z".into()], None));
    }
}
