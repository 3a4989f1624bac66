//! Where the axes of a volume point, in words.

use glam::DVec3;
use isoparticles_volume::{Geometry, Space};
use serde::Serialize;

/// How the grid lies in the world.
#[derive(Clone, Debug, Serialize)]
pub struct Orientation {
    /// Each axis from its first voxel to its last, such as `right to left`, or `+x` where the file names no anatomical space.
    pub axes: [String; 3],
    /// The same by the letters of the ends that the axes point to, such as `LPS`; `None` where the file names no anatomical space.
    pub letters: Option<String>,
    /// Largest angle between an axis of the grid and the axis of the world that it is nearest to, degrees.
    pub oblique_degrees: f64,
    /// Whether the way from the grid to the world mirrors.
    pub left_handed: bool,
    /// Whether two axes of the grid are not at a right angle (by more than a tenth of a degree).
    pub sheared: bool,
}

/// The ends of the world's axes (LPS): where they come from, where they point to.
const ENDS: [[&str; 2]; 3] = [["right", "left"], ["anterior", "posterior"], ["inferior", "superior"]];

impl Orientation {
    /// That of a grid.
    pub fn of(geometry: &Geometry) -> Self {
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

        // RAS, turned by 20 degrees about the body's axis, slices from the head down
        let (sine, cosine) = 20f64.to_radians().sin_cos();
        let directions = DMat3::from_cols(DVec3::new(-cosine, -sine, 0.0), DVec3::new(sine, -cosine, 0.0), -DVec3::Z);
        let turned = Orientation::of(&Geometry { directions, ..geometry.clone() });
        assert_eq!(turned.letters.as_deref(), Some("RAI"));
        assert_eq!(turned.axes[2], "superior to inferior");
        assert!(turned.left_handed && !turned.sheared);
        assert!((turned.oblique_degrees - 20.0).abs() < 1e-9);

        let unnamed = Orientation::of(&Geometry { space: Space::Unnamed, directions, ..geometry });
        assert_eq!((unnamed.axes, unnamed.letters), (["-x".into(), "-y".into(), "-z".into()], None));
    }
}
