//! Disjoint sets, and connected components of a mesh.

use crate::buckets::TASK_ITEMS;
use rayon::prelude::*;
use std::sync::atomic::{AtomicBool, AtomicU32, Ordering::Relaxed};

/// Component number of a vertex without triangles. No component has this number, because a mesh has
/// fewer components than vertices, and at most `u32::MAX` vertices.
pub const NO_COMPONENT: u32 = u32::MAX;

/// Union-find with path halving. Each set is represented by its smallest member, so the result does
/// not depend on the order of the joins.
#[derive(Clone, Debug)]
pub struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    /// Creates `count` sets with one member each.
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// Returns the smallest member of the set that contains x.
    pub fn find(&mut self, x: u32) -> u32 {
        let mut x = x;
        while self.parent[x as usize] != x {
            let above = self.parent[self.parent[x as usize] as usize];
            self.parent[x as usize] = above;
            x = above;
        }
        x
    }

    /// Merges the sets of a and b.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

/// Disjoint sets like [`DisjointSets`], but with concurrent joins. A root is attached to a smaller
/// root by compare-and-exchange (Jayanti and Tarjan 2016).
pub(crate) struct SharedSets(Vec<AtomicU32>);

impl SharedSets {
    /// Creates `count` sets with one member each.
    pub(crate) fn new(count: usize) -> Self {
        Self((0..count as u32).into_par_iter().map(AtomicU32::new).collect())
    }

    fn find(&self, x: u32) -> u32 {
        let mut x = x;
        loop {
            let parent = self.0[x as usize].load(Relaxed);
            let above = self.0[parent as usize].load(Relaxed);
            if above == parent {
                return parent;
            }
            // A failed exchange is harmless. Either another thread has changed the parent, or the
            // failure is spurious.
            let _ = self.0[x as usize].compare_exchange_weak(parent, above, Relaxed, Relaxed);
            x = above;
        }
    }

    /// Merges the sets of a and b.
    pub(crate) fn join(&self, a: u32, b: u32) {
        loop {
            let (a, b) = (self.find(a), self.find(b));
            let (root, other) = (a.min(b), a.max(b));
            if root == other || self.0[other as usize].compare_exchange(other, root, Relaxed, Relaxed).is_ok() {
                return;
            }
        }
    }

    /// Returns the number of the set of each member for which `is_used` is true, and
    /// [`NO_COMPONENT`] for the others, and the number of sets. Sets are numbered in the order of
    /// their first members. A used member must not share a set with one that is not used.
    pub(crate) fn numbers(&self, is_used: impl Fn(usize) -> bool) -> (Vec<u32>, usize) {
        let mut numbers = vec![NO_COMPONENT; self.0.len()];
        let mut sets = 0;
        for member in (0..numbers.len()).filter(|&member| is_used(member)) {
            // the root is the smallest member, so it is either `member` itself or already numbered
            let root = self.find(member as u32) as usize;
            numbers[member] = if root == member { sets } else { numbers[root] };
            sets += u32::from(root == member);
        }
        (numbers, sets as usize)
    }
}

/// Returns the component of each vertex, and the number of components. The vertices of a triangle
/// are in the same component. Components are numbered in the order of their first vertices.
/// Vertices without triangles get [`NO_COMPONENT`].
pub fn of_vertices(count: usize, triangles: &[[u32; 3]]) -> (Vec<u32>, usize) {
    let sets = SharedSets::new(count);
    let used: Vec<AtomicBool> = (0..count).map(|_| AtomicBool::new(false)).collect();
    triangles.par_iter().with_min_len(TASK_ITEMS).for_each(|&[a, b, c]| {
        sets.join(a, b);
        sets.join(b, c);
        for v in [a, b, c] {
            used[v as usize].store(true, Relaxed);
        }
    });
    sets.numbers(|v| used[v].load(Relaxed))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn numbers_components_by_first_vertex() {
        let (number, count) = of_vertices(8, &[[4, 5, 6], [0, 2, 3], [2, 3, 0]]);
        assert_eq!((number, count), (vec![0, NO_COMPONENT, 0, 0, 1, 1, 1, NO_COMPONENT], 2));
        assert_eq!(of_vertices(0, &[]), (vec![], 0));
    }

    #[test]
    fn components_of_many_are_those_of_one_set_after_the_other() {
        // triangle strips of different lengths, with the triangles in random order
        let count = 60_000u32;
        let mut triangles: Vec<[u32; 3]> =
            (0..count - 2).filter(|n| n % 997 < 900 && n % 31 < 29).map(|n| [n, n + 1, n + 2]).collect();
        triangles.sort_by_key(|t| t[0].wrapping_mul(0x9e37_79b9));
        let mut sets = DisjointSets::new(count as usize);
        for [a, b, c] in &triangles {
            sets.join(*a, *b);
            sets.join(*b, *c);
        }
        let mut is_used = vec![false; count as usize];
        triangles.iter().flatten().for_each(|&v| is_used[v as usize] = true);
        let firsts: Vec<u32> = (0..count).filter(|&v| sets.find(v) == v && is_used[v as usize]).collect();
        let number_of =
            |v: u32, sets: &mut DisjointSets| firsts.binary_search(&sets.find(v)).map_or(NO_COMPONENT, |n| n as u32);
        let expected: Vec<u32> = (0..count).map(|v| number_of(v, &mut sets)).collect();
        assert!(firsts.len() > 60 && expected.contains(&NO_COMPONENT));
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().expect("threads");
            let found = pool.install(|| of_vertices(count as usize, &triangles));
            assert_eq!(found, (expected.clone(), firsts.len()));
        }
    }

    #[test]
    fn the_order_of_joining_does_not_matter() {
        let pairs = [(5, 3), (1, 2), (3, 2), (6, 7)];
        let (mut forth, mut back) = (DisjointSets::new(8), DisjointSets::new(8));
        pairs.iter().for_each(|&(a, b)| forth.join(a, b));
        pairs.iter().rev().for_each(|&(a, b)| back.join(b, a));
        let roots = |sets: &mut DisjointSets| (0..8).map(|x| sets.find(x)).collect::<Vec<_>>();
        assert_eq!(roots(&mut forth), [0, 1, 1, 1, 4, 1, 6, 6]);
        assert_eq!(roots(&mut forth), roots(&mut back));
    }
}
