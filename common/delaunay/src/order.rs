//! Computes a biased randomised insertion order (Amenta, Choi and Rote 2003). Each round has about
//! eight times as many points as the previous round and follows a Hilbert curve. The walk from each
//! inserted point to the next one is then short, whatever the order of the input.

use glam::DVec3;
use rayon::prelude::*;

/// Number of bits of the Hilbert index per axis. The full index has 60 bits and fits in a `u64`.
/// Points in the same Hilbert cell are ordered by their coordinates.
const BITS_PER_AXIS: u32 = 20;

/// Minimum number of distinct points for which several rounds are used. The first round then has
/// about 125 to 1000 points. For label 2 of `thorax_labels` (84,000 particles), the step
/// `triangulate` of `reconstruct` takes 0.28 s if this limit is 250, 1000 or 4000, and 0.34 s with
/// a single round.
const FEWEST_FOR_ROUNDS: usize = 1000;

/// The insertion order of a set of points.
pub(super) struct Order {
    /// Indices of the distinct points, in the order of insertion.
    pub(super) order: Vec<u32>,
    /// End of each round, as an index into `order`.
    pub(super) rounds: Vec<usize>,
    /// For every point, the index of the first point with the same coordinates, usually the point
    /// itself.
    pub(super) first: Vec<u32>,
}

/// Computes the insertion order of points.
pub(super) fn insertion_order(points: &[DVec3]) -> Order {
    let low = points.iter().copied().reduce(DVec3::min).unwrap_or_default();
    let high = points.iter().copied().reduce(DVec3::max).unwrap_or_default();
    let extent = (high - low).max_element();
    let cells = f64::from((1u32 << BITS_PER_AXIS) - 1);
    let scale = if extent > 0.0 { cells / extent } else { 0.0 };
    let mut along: Vec<(u64, u32)> = points
        .par_iter()
        .enumerate()
        .map(|(i, &p)| {
            let cell = ((p - low) * scale).to_array().map(|x| x as u32);
            (hilbert_index(cell), i as u32)
        })
        .collect();
    along.par_sort_unstable();
    let mut first: Vec<u32> = (0..points.len() as u32).collect();
    let mut distinct: Vec<u32> = Vec::with_capacity(points.len());
    // Equal points lie in the same Hilbert cell. Sorting the points of each cell by coordinates
    // makes equal points adjacent.
    for group in along.chunk_by_mut(|a, b| a.0 == b.0) {
        if group.len() > 1 {
            group.sort_unstable_by(|a, b| {
                let (p, q) = (points[a.1 as usize], points[b.1 as usize]);
                p.x.total_cmp(&q.x).then(p.y.total_cmp(&q.y)).then(p.z.total_cmp(&q.z)).then(a.1.cmp(&b.1))
            });
        }
        let mut kept = group[0].1;
        distinct.push(kept);
        for &(_, i) in &group[1..] {
            if points[i as usize] == points[kept as usize] {
                first[i as usize] = kept;
            } else {
                kept = i;
                distinct.push(i);
            }
        }
    }
    let rounds = (distinct.len() / FEWEST_FOR_ROUNDS).checked_ilog2().map_or(0, |n| n / 3 + 1);
    let mut order = Vec::with_capacity(distinct.len());
    let mut ends = Vec::new();
    // a point is in the last round with probability 7/8, in the previous round with 7/64, and so on
    let round_of = |i: u32| rounds.saturating_sub(well_mixed(i).trailing_ones() / 3);
    for round in 0..=rounds {
        // every other round is reversed, so that it starts near the end of the previous round
        let members = distinct.iter().copied().filter(|&i| round_of(i) == round);
        let start = order.len();
        order.extend(members);
        if round % 2 == 1 {
            order[start..].reverse();
        }
        ends.push(order.len());
    }
    Order { order, rounds: ends, first }
}

/// Returns 64 bits that look random but depend only on the index. Uses the finaliser of SplitMix64
/// (Steele, Lea and Flood 2014).
fn well_mixed(index: u32) -> u64 {
    // The offset is arbitrary. A different offset changes the insertion order and therefore the
    // numbering of the tetrahedra.
    let x = 0x134a_bdb5_a05c_6011_u64.wrapping_add(u64::from(index));
    let x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    let x = (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb);
    x ^ (x >> 31)
}

/// Returns the position of a cell along the three-dimensional Hilbert curve, computed with
/// Skilling's transposition method (2004).
fn hilbert_index(mut x: [u32; 3]) -> u64 {
    let top = 1u32 << (BITS_PER_AXIS - 1);
    let mut q = top;
    while q > 1 {
        let below = q - 1;
        for i in 0..3 {
            if x[i] & q != 0 {
                x[0] ^= below;
            } else {
                let t = (x[0] ^ x[i]) & below;
                x[0] ^= t;
                x[i] ^= t;
            }
        }
        q >>= 1;
    }
    x[1] ^= x[0];
    x[2] ^= x[1];
    let mut t = 0;
    q = top;
    while q > 1 {
        if x[2] & q != 0 {
            t ^= q - 1;
        }
        q >>= 1;
    }
    x.iter_mut().for_each(|v| *v ^= t);
    let mut index = 0u64;
    for level in (0..BITS_PER_AXIS).rev() {
        for v in x {
            index = index << 1 | u64::from(v >> level & 1);
        }
    }
    index
}

#[cfg(test)]
mod tests {
    use super::*;
    use isoparticles_field::random::bits;

    #[test]
    fn hilbert_curve_steps_to_a_neighbour() {
        let mut cells: Vec<(u64, [u32; 3])> = Vec::new();
        for i in 0..8u32 {
            for j in 0..8 {
                for k in 0..8 {
                    cells.push((hilbert_index([i, j, k]), [i, j, k]));
                }
            }
        }
        cells.sort_unstable();
        for pair in cells.windows(2) {
            let step: u32 = (0..3).map(|a| pair[0].1[a].abs_diff(pair[1].1[a])).sum();
            assert_eq!(step, 1, "{pair:?}");
            assert_eq!(pair[1].0 - pair[0].0, 1);
        }
    }

    #[test]
    fn order_is_a_permutation_of_the_distinct_points() {
        let points: Vec<DVec3> =
            (0..5000u64).map(|n| DVec3::new((bits(1, 0, n) % 17) as f64, (bits(1, 1, n) % 13) as f64, 0.5)).collect();
        let Order { order, rounds, first } = insertion_order(&points);
        assert!(rounds.is_sorted() && rounds.last() == Some(&order.len()));
        assert_eq!(order.len(), 17 * 13);
        for (i, &f) in first.iter().enumerate() {
            assert_eq!(points[f as usize], points[i]);
            assert!(f as usize <= i, "the representative is the first of its kind");
            assert_eq!(first[f as usize], f);
        }
        assert!(order.iter().all(|&i| first[i as usize] == i));
    }
}
