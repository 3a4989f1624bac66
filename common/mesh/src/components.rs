//! Disjoint sets, and the connected components of a mesh's vertices that they give.

/// Number of a vertex that belongs to no triangle, and so to no component.
pub const NO_COMPONENT: u32 = u32::MAX;

/// Union-find with path halving; the smallest member represents a set, so that the order of joining does not matter.
#[derive(Clone, Debug)]
pub struct DisjointSets {
    parent: Vec<u32>,
}

impl DisjointSets {
    /// `count` sets of one member each.
    pub fn new(count: usize) -> Self {
        Self { parent: (0..count as u32).collect() }
    }

    /// The smallest member of the set that x belongs to.
    pub fn find(&mut self, x: u32) -> u32 {
        let mut x = x;
        while self.parent[x as usize] != x {
            let above = self.parent[self.parent[x as usize] as usize];
            self.parent[x as usize] = above;
            x = above;
        }
        x
    }

    /// Makes one set of those of a and b.
    pub fn join(&mut self, a: u32, b: u32) {
        let (a, b) = (self.find(a), self.find(b));
        self.parent[a.max(b) as usize] = a.min(b);
    }
}

/// Component of each vertex (joined through triangles), numbered in the order of their first vertices, and how many there
/// are; [`NO_COMPONENT`] for vertices of no triangle.
pub fn of_vertices(count: usize, triangles: &[[u32; 3]]) -> (Vec<u32>, usize) {
    let mut sets = DisjointSets::new(count);
    let mut number = vec![NO_COMPONENT; count];
    const USED: u32 = 0;
    for &[a, b, c] in triangles {
        sets.join(a, b);
        sets.join(b, c);
        for v in [a, b, c] {
            number[v as usize] = USED;
        }
    }
    let mut components = 0;
    for v in 0..count {
        if number[v] == NO_COMPONENT {
            continue;
        }
        // the root is the first of its set, so its number is known when the others ask for it
        let root = sets.find(v as u32) as usize;
        if root == v {
            number[v] = components;
            components += 1;
        } else {
            number[v] = number[root];
        }
    }
    (number, components as usize)
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
