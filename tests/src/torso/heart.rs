//! The heart-like part: ellipsoids for the chambers and tubes for the great vessels, blended into
//! one solid.

use super::pieces::{Ellipsoid, FAR, Tube, smooth_union};
use glam::DVec3;

pub(super) struct Heart {
    chambers: Vec<Ellipsoid>,
    vessels: Vec<Tube>,
}

impl Heart {
    pub(super) fn new() -> Self {
        let oblique = DVec3::new(0.4, 0.9, 0.2);
        let chambers = vec![
            // In order: left ventricle, right ventricle, left atrium, right atrium.
            Ellipsoid::aligned([24.0, -18.0, -28.0], [36.0, 25.0, 27.0]).turned(oblique, 35.0),
            Ellipsoid::aligned([-2.0, -28.0, -32.0], [32.0, 20.0, 26.0]).turned(oblique, 28.0),
            Ellipsoid::aligned([8.0, -1.0, -8.0], [26.0, 15.0, 19.0]),
            Ellipsoid::aligned([-26.0, -8.0, -14.0], [18.0, 20.0, 25.0]),
        ];
        let vessels = vec![
            // Aorta: up, over the arch, down in front of the spine.
            Tube::smooth(
                &[
                    ([0.0, -14.0, -12.0], 11.0),
                    ([-6.0, -16.0, 18.0], 11.0),
                    ([-4.0, -8.0, 44.0], 10.5),
                    ([10.0, 8.0, 54.0], 10.0),
                    ([20.0, 25.0, 38.0], 9.5),
                    ([21.0, 29.0, 0.0], 9.0),
                    ([19.0, 29.0, -72.0], 8.0),
                ],
                12,
            ),
            // Pulmonary trunk and its left branch.
            Tube::smooth(
                &[
                    ([4.0, -34.0, -14.0], 10.0),
                    ([14.0, -27.0, 14.0], 10.0),
                    ([25.0, -12.0, 27.0], 8.5),
                    ([36.0, -6.0, 26.0], 6.0),
                ],
                10,
            ),
            // Upper and lower vena cava.
            Tube::smooth(&[([-29.0, -9.0, -4.0], 8.5), ([-31.0, -8.0, 28.0], 8.0), ([-26.0, -5.0, 44.0], 7.5)], 8),
            Tube::smooth(&[([-25.0, -4.0, -28.0], 9.5), ([-22.0, 0.0, -58.0], 9.5)], 6),
        ];
        Self { chambers, vessels }
    }

    pub(super) fn value(&self, q: DVec3) -> f64 {
        let chambers = self.chambers.iter().map(|c| c.value(q)).fold(FAR, |a, b| smooth_union(a, b, 8.0));
        self.vessels.iter().fold(chambers, |value, tube| smooth_union(value, tube.value(q, value + 4.0), 3.0))
    }
}
