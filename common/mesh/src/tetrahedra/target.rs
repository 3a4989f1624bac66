//! Targets for the shape of each tetrahedron, and its score against them.

use super::quality::{Sizes, degrees};
use glam::DVec3;

/// Minimum dihedral angle in degrees that mending aims at, unless the limit of the check is larger.
const GOAL_DEGREES: f64 = 12.0;

/// Aim relative to the largest possible value, where the surface limits this value. Only the
/// tetrahedron that fills the place exactly reaches the largest value itself.
const NEARLY: f64 = 0.9;

/// Score of a tetrahedron at a limit of the checks.
pub const AT_LIMIT: f64 = 0.5;

/// The limits of the checks, and the angle to aim at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Goal {
    /// Minimum dihedral angle in degrees that the check requires, unless the surface allows less.
    pub limit_dihedral: f64,
    /// Minimum scaled Jacobian that the check requires, unless the surface allows less.
    pub limit_jacobian: f64,
    /// Minimum dihedral angle in degrees to aim at.
    pub aim_dihedral: f64,
}

/// Two values of one measure.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Target {
    /// Value that the check requires; 0 if the surface does not allow it.
    pub(super) limit: f64,
    /// The value to reach, at least the limit.
    pub(super) aim: f64,
}

/// Targets of one tetrahedron.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Targets {
    pub(super) dihedral: Target,
    pub(super) jacobian: Target,
}

impl Goal {
    /// Returns the goal for the limits of the checks.
    pub fn of_limits(dihedral: f64, jacobian: f64) -> Self {
        Self { limit_dihedral: dihedral, limit_jacobian: jacobian, aim_dihedral: dihedral.max(GOAL_DEGREES) }
    }

    /// Returns the targets of a tetrahedron that the surface does not limit.
    pub(super) fn targets(&self) -> Targets {
        Targets {
            dihedral: Target { limit: self.limit_dihedral, aim: self.aim_dihedral },
            jacobian: Target { limit: self.limit_jacobian, aim: self.limit_jacobian },
        }
    }

    /// Returns the targets on a forced side with this bound. There, the scaled Jacobian is at most
    /// sqrt(2) sin(bound): in a corner at an edge with the dihedral angle b, whose faces have the
    /// angles s and t, six times the volume over the product of the edges is sin b sin s sin t.
    pub(super) fn beside(&self, bound: f64) -> Targets {
        let limit = if bound < self.limit_dihedral { 0.0 } else { self.limit_dihedral };
        let dihedral = Target { limit, aim: self.aim_dihedral.min(limit.max(NEARLY * bound)) };
        let possible = std::f64::consts::SQRT_2 * bound.to_radians().sin();
        Targets { dihedral, jacobian: self.with_jacobian(possible).jacobian }
    }

    /// Returns the targets where the scaled Jacobian is at most `possible`.
    pub(super) fn with_jacobian(&self, possible: f64) -> Targets {
        let mut targets = self.targets();
        if possible < self.limit_jacobian {
            targets.jacobian = Target { limit: 0.0, aim: NEARLY * possible };
        }
        targets
    }
}

impl Target {
    fn least(self, other: Self) -> Self {
        Self { limit: self.limit.min(other.limit), aim: self.aim.min(other.aim) }
    }

    /// Returns [`AT_LIMIT`] at the limit and 1 at the aim, linear between and below.
    #[inline]
    fn score(self, value: f64) -> f64 {
        if value < self.limit {
            AT_LIMIT * value / self.limit
        } else if value < self.aim {
            AT_LIMIT + (1.0 - AT_LIMIT) * (value - self.limit) / (self.aim - self.limit)
        } else {
            1.0
        }
    }
}

impl Targets {
    /// Returns the smaller of two targets for each measure.
    pub(super) fn least(self, other: Self) -> Self {
        Self { dihedral: self.dihedral.least(other.dihedral), jacobian: self.jacobian.least(other.jacobian) }
    }

    /// Returns the score of a tetrahedron: 1 if it reaches its targets, less than [`AT_LIMIT`] if
    /// it fails a check, and 0 or less if it is not positive. The worse of the two measures counts,
    /// so an unreachable aim does not outweigh a failed check.
    #[inline]
    pub(super) fn score(&self, corners: &[DVec3; 4]) -> f64 {
        let sizes = Sizes::of(corners);
        let jacobian = sizes.scaled_jacobian();
        if jacobian > 0.0 {
            self.jacobian.score(jacobian).min(self.dihedral.score(degrees(sizes.cosines[1])))
        } else {
            jacobian
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::quality::TetrahedronQuality;
    use super::*;
    use isoparticles_field::random::uniform;

    const GOAL: Goal = Goal { limit_dihedral: 5.0, limit_jacobian: 0.05, aim_dihedral: 12.0 };

    #[test]
    fn a_score_is_a_half_at_the_limits_and_1_at_the_aims() {
        let mut positive = 0;
        for n in 0..400 {
            let corners = [0, 1, 2, 3].map(|k| DVec3::from_array([0, 1, 2].map(|axis| uniform(3 + k, axis, n))));
            let quality = TetrahedronQuality::of(&corners);
            let found = GOAL.targets().score(&corners);
            if quality.volume <= 0.0 {
                assert!(found <= 0.0);
                continue;
            }
            positive += 1;
            let angle = quality.min_dihedral;
            let by_angle = if angle < 5.0 { 0.1 * angle } else { (0.5 + (angle - 5.0) / 14.0).min(1.0) };
            let jacobian = quality.scaled_jacobian;
            let expected = if jacobian < 0.05 { by_angle.min(10.0 * jacobian) } else { by_angle };
            assert!((found - expected).abs() < 1e-9, "{found} for {quality:?}");
        }
        assert!((150..250).contains(&positive));
    }

    #[test]
    fn a_forced_side_keeps_the_limits_that_it_allows() {
        let check = |bound: f64, dihedral: [f64; 2], jacobian: [f64; 2]| {
            let found = GOAL.beside(bound);
            for (target, [limit, aim]) in [(found.dihedral, dihedral), (found.jacobian, jacobian)] {
                assert!((target.limit - limit).abs() < 1e-12 && (target.aim - aim).abs() < 1e-12, "{bound}: {found:?}");
            }
        };
        // a bound of 3 degrees keeps the limit of the Jacobian, 1 degree none and 9 degrees both
        check(3.0, [0.0, 2.7], [0.05, 0.05]);
        check(1.0, [0.0, 0.9], [0.0, 0.9 * 2f64.sqrt() * 1f64.to_radians().sin()]);
        check(9.0, [5.0, 8.1], [0.05, 0.05]);
        check(5.2, [5.0, 5.0], [0.05, 0.05]);
    }
}
