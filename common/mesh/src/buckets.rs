//! Parallel list operations: concatenation, splitting into parts, and sorting into buckets. The
//! bucket sort is a counting sort in which each thread reads all items but writes only its own
//! buckets, which avoids scattered writes.

use rayon::prelude::*;
use std::ops::Range;

/// Minimum number of triangles or buckets per task of a parallel loop. At 10 ns or more per item, a
/// task takes at least 40 us. Starting a task takes 0.1 us, or 25 us if it wakes a thread (measured
/// with `rayon::join` after 2 ms of idleness, on a busy machine with 2 cores, 2026-11-27).
pub(crate) const TASK_ITEMS: usize = 1 << 12;

/// Items sorted by bucket.
pub struct Buckets {
    /// Start of each bucket in `items`, followed by the total number of items.
    pub starts: Vec<u32>,
    /// The items, in ascending order within each bucket.
    pub items: Vec<u32>,
}

impl Buckets {
    /// Sorts the items 0, 1, ... into `count` buckets. `bucket_of` contains the bucket number of
    /// each item. All bucket numbers must be below `count`.
    pub fn new(bucket_of: &[u32], count: usize) -> Self {
        debug_assert!(bucket_of.iter().all(|&bucket| (bucket as usize) < count), "a bucket is not below {count}");
        // each thread reads all items and handles its own range of buckets
        let share = count.div_ceil(rayon::current_num_threads()).max(TASK_ITEMS);
        let mut starts = vec![0u32; count + 1];
        starts[..count].par_chunks_mut(share).enumerate().for_each(|(n, counts)| {
            for &bucket in bucket_of {
                if let Some(count) = counts.get_mut((bucket as usize).wrapping_sub(n * share)) {
                    *count += 1;
                }
            }
        });
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        let mut items = vec![0u32; sum as usize];
        let firsts = (0..count).step_by(share);
        let bounds: Vec<&[u32]> = firsts.map(|first| &starts[first..=count.min(first + share)]).collect();
        let parts = parts_mut(&mut items, bounds.iter().map(|bounds| (bounds[bounds.len() - 1] - bounds[0]) as usize));
        parts.into_par_iter().zip(&bounds).enumerate().for_each(|(n, (own, bounds))| {
            let mut next: Vec<u32> = bounds[..bounds.len() - 1].iter().map(|start| start - bounds[0]).collect();
            for (item, &bucket) in (0..).zip(bucket_of) {
                if let Some(next) = next.get_mut((bucket as usize).wrapping_sub(n * share)) {
                    own[*next as usize] = item;
                    *next += 1;
                }
            }
        });
        Self { starts, items }
    }

    /// Returns the items of a bucket, ascending.
    pub fn of(&self, bucket: u32) -> &[u32] {
        &self.items[self.starts[bucket as usize] as usize..self.starts[bucket as usize + 1] as usize]
    }
}

/// Returns the start offsets of consecutive parts of the given lengths.
pub fn starts_of(lengths: impl IntoIterator<Item = usize>) -> Vec<u32> {
    let starts = lengths.into_iter().scan(0, |next, length| {
        let start = *next;
        *next += length as u32;
        Some(start)
    });
    starts.collect()
}

/// Concatenates all lists in order. Needs memory for the lists and the result at the same time.
pub fn joined<T: Copy + Default + Send + Sync>(lists: Vec<Vec<T>>) -> Vec<T> {
    // The first access to new memory is slower than the copy itself, so the memory is initialised
    // in parallel.
    let lengths: Vec<usize> = lists.iter().map(Vec::len).collect();
    let mut all: Vec<T> = (0..lengths.iter().sum()).into_par_iter().map(|_| T::default()).collect();
    parts_mut(&mut all, lengths).into_par_iter().zip(lists).for_each(|(own, list)| own.copy_from_slice(&list));
    all
}

/// Splits a list into consecutive mutable parts of the given lengths.
pub fn parts_mut<T>(list: &mut [T], lengths: impl IntoIterator<Item = usize>) -> Vec<&mut [T]> {
    let mut rest = list;
    let mut parts = Vec::new();
    for length in lengths {
        let (own, others) = rest.split_at_mut(length);
        parts.push(own);
        rest = others;
    }
    parts
}

/// Returns mutable slices of a list for the given ranges, which must be ascending and disjoint.
pub fn ranges_mut<'l, T>(list: &'l mut [T], ranges: &[Range<usize>]) -> Vec<&'l mut [T]> {
    let mut end = 0;
    let lengths = ranges.iter().flat_map(|range| {
        let gap = range.start - end;
        end = range.end;
        [gap, range.len()]
    });
    parts_mut(list, lengths).into_iter().skip(1).step_by(2).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_of_a_list_are_those_of_their_ranges() {
        let mut list: Vec<usize> = (0..20).collect();
        let ranges = [2..2, 2..5, 5..6, 9..9, 12..20, 20..20];
        let found: Vec<Vec<usize>> = ranges_mut(&mut list, &ranges).into_iter().map(|part| part.to_vec()).collect();
        assert_eq!(found, ranges.map(|range| range.collect::<Vec<_>>()));
    }

    #[test]
    fn lists_follow_each_other_in_one() {
        let lists: Vec<Vec<u32>> = (0..40).map(|n| (n * n..n * n + n % 7 * 100).collect()).collect();
        assert_eq!(joined(lists.clone()), lists.concat());
        assert!(joined::<u32>(Vec::new()).is_empty());
        let starts = starts_of(lists.iter().map(Vec::len));
        let begins = |n: usize| lists[..n].concat().len() as u32;
        assert_eq!(starts, (0..lists.len()).map(begins).collect::<Vec<_>>());
    }

    #[test]
    fn items_come_in_order_on_any_number_of_threads() {
        let count = 3 * TASK_ITEMS + 17;
        let bucket_of: Vec<u32> = (0..40_000u64).map(|n| (n * n * 7 % count as u64) as u32).collect();
        let mut expected: Vec<(u32, u32)> = bucket_of.iter().copied().zip(0..).collect();
        expected.sort_unstable();
        for threads in [1, 3, 8] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let made = pool.install(|| Buckets::new(&bucket_of, count));
            assert_eq!(made.items, expected.iter().map(|own| own.1).collect::<Vec<_>>());
            for bucket in 0..count {
                let own = &made.items[made.starts[bucket] as usize..made.starts[bucket + 1] as usize];
                assert!(own.iter().all(|&item| bucket_of[item as usize] as usize == bucket), "{bucket}");
            }
        }
        let none = Buckets::new(&[], 0);
        assert_eq!((none.starts, none.items), (vec![0], vec![]));
    }
}
