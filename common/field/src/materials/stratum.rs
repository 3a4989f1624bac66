//! Identifies a material interface, a junction curve or a junction point by the materials that meet
//! there.

use super::MaterialId;
use serde::{Deserialize, Serialize};

/// The materials that meet on a stratum, in ascending order: two on an interface, three on a
/// junction curve, four at a junction point.
///
/// More than four materials can meet at a junction point, because eight voxels meet at a corner.
/// Four of the materials then identify the point.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Stratum {
    /// Material numbers, ascending and padded with [`NONE`].
    ids: [MaterialId; 4],
}

/// Padding if there are fewer than four materials. No material has this number.
const NONE: MaterialId = MaterialId(u16::MAX);

impl Stratum {
    /// Creates the stratum of the given materials, in any order. Returns `None` unless there are
    /// two to four different materials.
    pub fn new(materials: &[MaterialId]) -> Option<Self> {
        let mut ids = [NONE; 4];
        ids.get_mut(..materials.len())?.copy_from_slice(materials);
        ids.sort_unstable();
        Self { ids }.is_valid().then_some(Self { ids })
    }

    /// Creates the interface of two different materials.
    ///
    /// # Panics
    /// If the materials are the same.
    pub fn interface(a: MaterialId, b: MaterialId) -> Self {
        assert_ne!(a, b, "a material has no interface with itself");
        Self { ids: [a.min(b), a.max(b), NONE, NONE] }
    }

    /// Returns whether the stratum has two to four different materials in ascending order. File
    /// readers use this check.
    pub fn is_valid(&self) -> bool {
        let count = self.count();
        (2..=4).contains(&count) && self.ids[..count].is_sorted_by(|a, b| a < b)
    }

    /// Returns the materials in ascending order.
    pub fn materials(&self) -> &[MaterialId] {
        &self.ids[..self.count()]
    }

    /// Returns the number of materials: 2, 3 or 4.
    pub fn count(&self) -> usize {
        self.ids.iter().position(|&id| id == NONE).unwrap_or(4)
    }

    /// Returns the dimension: 2 for an interface, 1 for a junction curve, 0 for a junction point.
    pub fn dimension(&self) -> usize {
        4 - self.count()
    }

    /// Returns the stratum at which the materials of both strata meet, or `None` if there are more
    /// than four of them.
    pub fn joined(&self, other: &Self) -> Option<Self> {
        let mut ids = self.materials().to_vec();
        ids.extend(other.materials().iter().filter(|&&id| !self.has(id)));
        Self::new(&ids)
    }

    /// Returns whether a material belongs to the stratum.
    pub fn has(&self, id: MaterialId) -> bool {
        self.materials().contains(&id)
    }

    /// Returns whether this stratum has all materials of `other`, so that it equals `other` or can
    /// lie on its boundary.
    pub fn is_on(&self, other: &Self) -> bool {
        other.materials().iter().all(|&id| self.has(id))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn stratum(ids: &[u16]) -> Option<Stratum> {
        Stratum::new(&ids.iter().map(|&id| MaterialId(id)).collect::<Vec<_>>())
    }

    #[test]
    fn a_stratum_is_two_to_four_materials_in_any_order() {
        let curve = stratum(&[7, 0, 3]).expect("three");
        assert_eq!(Some(curve), stratum(&[3, 7, 0]));
        assert_eq!((curve.count(), curve.dimension()), (3, 1));
        assert_eq!(curve.materials(), [MaterialId(0), MaterialId(3), MaterialId(7)]);
        for wrong in [&[1][..], &[1, 1], &[1, 2, 2], &[1, 2, 3, 4, 5], &[1, u16::MAX]] {
            assert_eq!(stratum(wrong), None);
        }
    }

    #[test]
    fn strata_join_up_to_four_materials() {
        let of = |ids: &[u16]| stratum(ids).expect("valid");
        assert_eq!(of(&[0, 3, 7]).joined(&of(&[7, 2, 0])), stratum(&[0, 2, 3, 7]));
        assert_eq!(of(&[0, 3, 7, 8]).joined(&of(&[7, 2, 0])), None);
    }

    #[test]
    fn lower_strata_lie_on_those_whose_materials_they_have() {
        let (interface, curve, point) = (stratum(&[0, 3]), stratum(&[0, 3, 7]), stratum(&[0, 2, 3, 9]));
        let [interface, curve, point] = [interface, curve, point].map(|stratum| stratum.expect("valid"));
        assert_eq!(interface, Stratum::interface(MaterialId(3), MaterialId(0)));
        assert!(curve.is_on(&interface) && point.is_on(&interface) && interface.is_on(&interface));
        assert!(!interface.is_on(&curve) && !point.is_on(&curve));
    }
}
