//! The materials that meet at a position, which identify a material interface, a junction curve or
//! a junction point.

use super::MaterialId;
use serde::{Deserialize, Serialize};

/// The materials that meet on a stratum, ascending: two on an interface, three on a junction curve,
/// four at a junction point.
///
/// A junction point of more than four materials (labels at a corner of many voxels) is named by
/// four of them.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize, Deserialize)]
pub struct Stratum {
    /// Ascending, padded with [`NONE`].
    ids: [MaterialId; 4],
}

/// Padding for fewer than four materials; no material has this number.
const NONE: MaterialId = MaterialId(u16::MAX);

impl Stratum {
    /// The stratum of some materials in any order; `None` unless they are two to four different
    /// ones.
    pub fn new(materials: &[MaterialId]) -> Option<Self> {
        let mut ids = [NONE; 4];
        ids.get_mut(..materials.len())?.copy_from_slice(materials);
        ids.sort_unstable();
        Self { ids }.is_valid().then_some(Self { ids })
    }

    /// The interface of two different materials.
    ///
    /// # Panics
    /// If they are the same.
    pub fn sheet(a: MaterialId, b: MaterialId) -> Self {
        assert_ne!(a, b, "a material has no sheet with itself");
        Self { ids: [a.min(b), a.max(b), NONE, NONE] }
    }

    /// Whether the numbers are of two to four materials, ascending; checked when files are read.
    pub fn is_valid(&self) -> bool {
        let count = self.count();
        (2..=4).contains(&count) && self.ids[..count].is_sorted_by(|a, b| a < b)
    }

    /// The materials, ascending.
    pub fn materials(&self) -> &[MaterialId] {
        &self.ids[..self.count()]
    }

    /// Number of materials: 2, 3 or 4.
    pub fn count(&self) -> usize {
        self.ids.iter().position(|&id| id == NONE).unwrap_or(4)
    }

    /// 2 for an interface, 1 for a junction curve, 0 for a junction point.
    pub fn dimension(&self) -> usize {
        4 - self.count()
    }

    /// The stratum of the materials of both; `None` if there are more than four.
    pub fn joined(&self, other: &Self) -> Option<Self> {
        let mut ids = self.materials().to_vec();
        ids.extend(other.materials().iter().filter(|&&id| !self.has(id)));
        Self::new(&ids)
    }

    /// The junction curves that it lies on, each of three of its materials. A curve lies on itself,
    /// an interface on none.
    pub fn curves(&self) -> impl Iterator<Item = Self> + use<> {
        let ids = self.ids;
        let three = move |skipped: usize| [0, 1, 2].map(|n| ids[n + usize::from(n >= skipped)]);
        let skipped = if self.count() < 3 { 4..4 } else { self.count() % 4..4 };
        skipped.filter_map(move |skipped| Self::new(&three(skipped)))
    }

    /// Whether a material is one of them.
    pub fn has(&self, id: MaterialId) -> bool {
        self.materials().contains(&id)
    }

    /// Whether this stratum has all materials of `other`: it can lie on the border of `other`, or
    /// equals it.
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
    fn strata_join_up_to_four_materials_and_list_their_curves() {
        let of = |ids: &[u16]| stratum(ids).expect("valid");
        assert_eq!(of(&[0, 3, 7]).joined(&of(&[7, 2, 0])), stratum(&[0, 2, 3, 7]));
        assert_eq!(of(&[0, 3, 7, 8]).joined(&of(&[7, 2, 0])), None);
        assert_eq!(of(&[0, 3]).curves().count(), 0);
        assert_eq!(of(&[0, 3, 7]).curves().collect::<Vec<_>>(), [of(&[0, 3, 7])]);
        let four = [[3, 7, 9], [0, 7, 9], [0, 3, 9], [0, 3, 7]].map(|ids| of(&ids));
        assert_eq!(of(&[0, 3, 7, 9]).curves().collect::<Vec<_>>(), four);
    }

    #[test]
    fn lower_strata_lie_on_those_whose_materials_they_have() {
        let (sheet, curve, point) = (stratum(&[0, 3]), stratum(&[0, 3, 7]), stratum(&[0, 2, 3, 9]));
        let [sheet, curve, point] = [sheet, curve, point].map(|stratum| stratum.expect("valid"));
        assert_eq!(sheet, Stratum::sheet(MaterialId(3), MaterialId(0)));
        assert!(curve.is_on(&sheet) && point.is_on(&sheet) && sheet.is_on(&sheet));
        assert!(!sheet.is_on(&curve) && !point.is_on(&curve));
    }
}
