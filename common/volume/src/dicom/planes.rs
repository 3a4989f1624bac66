//! Finds the common spacing of parallel planes, some of which may be missing: writers omit the
//! empty frames of segmentations, and contours exist only where an object is.

use super::stack::LARGEST_SHIFT;

/// Maximum number of planes if most of them are missing: about the number of 1 mm slices in a
/// whole-body scan of 2 m. The limit bounds the memory that a file with few frames can require.
const MOST_SPARSE: usize = 2048;

/// Evenly spaced planes.
#[derive(Debug, PartialEq)]
pub(super) struct Planes {
    /// Distance between neighbouring planes in mm.
    pub(super) spacing: f64,
    /// Positions along the normal in mm, in ascending order, and the index of the plane at each.
    places: Vec<(f64, usize)>,
}

impl Planes {
    /// Finds the planes at `places`, which are positions along a normal in mm. Positions closer
    /// than `tolerance` are merged. The candidates for the spacing are `declared`, the minimum
    /// distance and `thickness`, in this order. The first candidate that divides all distances, up
    /// to rounding, is the spacing. Returns `None` if no candidate does.
    pub(super) fn new(
        mut places: Vec<f64>,
        tolerance: f64,
        declared: Option<f64>,
        thickness: Option<f64>,
    ) -> Option<Self> {
        places.sort_by(f64::total_cmp);
        places.dedup_by(|b, a| *b - *a <= tolerance);
        let smallest = places.windows(2).map(|pair| pair[1] - pair[0]).min_by(f64::total_cmp);
        [declared, smallest, thickness].into_iter().flatten().find_map(|spacing| Self::spaced(&places, spacing))
    }

    /// Returns the planes if all distances are approximately multiples of `spacing`.
    fn spaced(places: &[f64], spacing: f64) -> Option<Self> {
        let (first, last) = (*places.first()?, *places.last()?);
        let mut index = 0;
        let mut indices = vec![0];
        for pair in places.windows(2) {
            let planes = ((pair[1] - pair[0]) / spacing).round();
            if planes < 1.0 || planes > places.len().max(MOST_SPARSE) as f64 {
                return None;
            }
            index += planes as usize;
            indices.push(index);
        }
        let spacing = if index == 0 { spacing } else { (last - first) / index as f64 };
        let is_near =
            |(place, index): (&f64, &usize)| (place - first - spacing * *index as f64).abs() <= LARGEST_SHIFT * spacing;
        let is_regular = index < places.len().max(MOST_SPARSE) && places.iter().zip(&indices).all(is_near);
        is_regular.then(|| Self { spacing, places: places.iter().copied().zip(indices).collect() })
    }

    /// Returns the number of planes from the first to the last one.
    pub(super) fn count(&self) -> usize {
        self.places.last().map_or(0, |(_, index)| index + 1)
    }

    /// Returns the index of the plane nearest to a position.
    pub(super) fn index(&self, place: f64) -> usize {
        let after = self.places.partition_point(|&(other, _)| other < place);
        let around = self.places[after.saturating_sub(1)..].iter().take(2);
        let near = around.min_by(|a, b| (a.0 - place).abs().total_cmp(&(b.0 - place).abs()));
        near.map_or(0, |&(_, index)| index)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn planes(places: &[f64], declared: Option<f64>, thickness: Option<f64>) -> Option<(f64, Vec<usize>)> {
        let planes = Planes::new(places.to_vec(), 0.01, declared, thickness)?;
        Some((planes.spacing, places.iter().map(|&place| planes.index(place)).collect()))
    }

    #[test]
    fn missing_planes_keep_their_place() {
        assert_eq!(planes(&[4.0, 0.0, 10.0, 4.0], None, None), None);
        assert_eq!(planes(&[4.0, 0.0, 12.0, 4.0], None, None), Some((4.0, vec![1, 0, 3, 1])));
        assert_eq!(planes(&[4.0, 0.0, 10.0], None, Some(2.0)), Some((2.0, vec![2, 0, 5])));
        assert_eq!(planes(&[4.0, 0.0], Some(1.0), None), Some((1.0, vec![4, 0])));
        assert_eq!(planes(&[4.0], None, Some(3.0)), Some((3.0, vec![0])));
        assert_eq!(planes(&[4.0], None, None), None);
        assert_eq!(planes(&[0.0, 1.0, 1e9], None, None), None);
    }

    /// The true spacing is 0.703125 mm. Rounded to 0.7 mm, 300 slices would deviate by 0.9 mm.
    #[test]
    fn rounded_places_give_the_mean_spacing() {
        let places: Vec<f64> = (0..300).map(|n| (f64::from(n) * 0.703_125 * 100.0).round() / 100.0).collect();
        let (spacing, indices) = planes(&places, None, None).expect("regular");
        assert!((spacing - 0.703_125).abs() < 1e-4, "{spacing}");
        assert!(indices.into_iter().eq(0..300));
    }
}
