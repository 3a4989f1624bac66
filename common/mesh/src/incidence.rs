//! The triangles at each vertex, and the edges, fans and Euler characteristics derived from them.
//! Iterative algorithms rebuild these lists often, so they are built by a counting sort, which is
//! faster than a comparison sort.

use crate::buckets::{Buckets, TASK_ITEMS};
use rayon::prelude::*;

/// Number of vertices per task. A closed surface has about half as many vertices as triangles.
const TASK_VERTICES: usize = TASK_ITEMS / 2;

/// Buffers that [`Incidence::fans_at`] reuses for all vertices.
#[derive(Default)]
pub struct FanWork {
    /// For each triangle side that ends at the vertex: the other end of the side, and the position
    /// of the triangle in the result of [`Incidence::of`].
    ends: Vec<(u32, u32)>,
    /// Fan number of each triangle at the vertex.
    fan: Vec<u32>,
}

/// The triangles at each vertex of a triangle list.
pub struct Incidence<'a> {
    triangles: &'a [[u32; 3]],
    /// Start of the triangles of each vertex in `at_vertex`, followed by the length of `at_vertex`.
    starts: Vec<u32>,
    at_vertex: Vec<u32>,
}

impl<'a> Incidence<'a> {
    /// Indexes the triangles. All vertex indices must be below `vertex_count`.
    pub fn new(triangles: &'a [[u32; 3]], vertex_count: usize) -> Self {
        let Buckets { starts, items } = Buckets::new(triangles.as_flattened(), vertex_count);
        // each item identifies a corner by `3 * triangle + position in the triangle`
        let at_vertex = items.into_par_iter().map(|corner| corner / 3).collect();
        Self { triangles, starts, at_vertex }
    }

    /// Returns the triangles.
    pub fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles
    }

    /// Returns the triangles at a vertex in ascending order.
    pub fn of(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.at_vertex[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// Returns the number of vertices, including vertices without triangles.
    pub fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Calls `found` for each edge from `vertex` to a vertex with a larger index. The arguments are
    /// the other end, and a pair (other end, triangle) for each triangle at the edge. Edges and
    /// triangles are visited in ascending order.
    fn edges_from(&self, vertex: u32, ends: &mut Vec<(u32, u32)>, mut found: impl FnMut(u32, &[(u32, u32)])) {
        ends.clear();
        for &t in self.of(vertex) {
            let others = self.triangles[t as usize].into_iter().filter(|&other| other > vertex);
            ends.extend(others.map(|other| (other, t)));
        }
        ends.sort_unstable();
        ends.chunk_by(|a, b| a.0 == b.0).for_each(|edge| found(edge[0].0, edge));
    }

    /// Returns the number of triangle fans at a vertex. Two triangles that share an edge at the
    /// vertex belong to the same fan if no other triangle contains this edge. A manifold vertex has
    /// one fan, and an unused vertex has none. If an edge at the vertex does not lie in exactly two
    /// triangles, its other end and its triangles are passed to `other_edge`.
    pub fn fans_at(
        &self,
        vertex: u32,
        work: &mut FanWork,
        mut other_edge: impl FnMut(u32, &mut dyn Iterator<Item = u32>),
    ) -> usize {
        let around = self.of(vertex);
        let FanWork { ends, fan } = work;
        ends.clear();
        for (k, &t) in (0..).zip(around) {
            let others = self.triangles[t as usize].into_iter().filter(|&other| other != vertex);
            ends.extend(others.map(|other| (other, k)));
        }
        ends.sort_unstable();
        fan.clear();
        fan.extend(0..around.len() as u32);
        let mut count = around.len();
        for edge in ends.chunk_by(|a, b| a.0 == b.0) {
            if let [(_, first), (_, second)] = *edge {
                let (kept, gone) = (fan[first as usize], fan[second as usize]);
                if kept != gone {
                    fan.iter_mut().filter(|f| **f == gone).for_each(|f| *f = kept);
                    count -= 1;
                }
            } else {
                other_edge(edge[0].0, &mut edge.iter().map(|&(_, k)| around[k as usize]));
            }
        }
        count
    }

    /// Returns the Euler characteristic V - E + F of each class of triangles. `class` contains the
    /// class number of each triangle, and all numbers must be below `classes`. A vertex or edge is
    /// counted once in each class that uses it.
    pub fn euler_characteristics(&self, class: &[u32], classes: usize) -> Vec<i64> {
        let chunks = (0..self.vertex_count()).into_par_iter().step_by(TASK_VERTICES);
        let sums = chunks.map(|first| {
            let mut euler = vec![0i64; classes];
            let (mut ends, mut seen) = (Vec::new(), Vec::new());
            let mut count = |triangles: &mut dyn Iterator<Item = u32>, sign: i64| {
                seen.clear();
                for class in triangles.map(|t| class[t as usize]) {
                    if !seen.contains(&class) {
                        seen.push(class);
                        euler[class as usize] += sign;
                    }
                }
            };
            for v in first as u32..(first + TASK_VERTICES).min(self.vertex_count()) as u32 {
                count(&mut self.of(v).iter().copied(), 1);
                self.edges_from(v, &mut ends, |_, edge| count(&mut edge.iter().map(|end| end.1), -1));
            }
            euler
        });
        let mut euler = sums.reduce(
            || vec![0; classes],
            |mut a, b| {
                a.iter_mut().zip(b).for_each(|(a, b)| *a += b);
                a
            },
        );
        class.iter().for_each(|&c| euler[c as usize] += 1);
        euler
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn two_tetrahedra_that_share_an_edge() {
        let one = [[1, 2, 3], [0, 3, 2], [0, 1, 3], [0, 2, 1]];
        let other = one.map(|t| t.map(|v: u32| v + 2));
        let triangles = [one, other].concat();
        let incidence = Incidence::new(&triangles, 7);
        assert_eq!(incidence.of(1), [0, 2, 3]);
        assert_eq!(incidence.of(2), [0, 1, 3, 5, 6, 7]);
        assert!(incidence.of(6).is_empty());
        let class = [0, 0, 0, 0, 2, 2, 2, 2];
        assert_eq!(incidence.euler_characteristics(&class, 3), [2, 0, 2]);
        // six vertices, eleven edges, eight triangles
        assert_eq!(incidence.euler_characteristics(&[0; 8], 1), [3]);
        let mut work = FanWork::default();
        let mut others = Vec::new();
        let counts = [0, 1, 2, 3, 4, 5, 6].map(|v| {
            incidence.fans_at(v, &mut work, |end, around| others.push((v, end, around.collect::<Vec<u32>>())))
        });
        assert_eq!(counts, [1, 1, 2, 2, 1, 1, 0]);
        assert_eq!(others, [(2, 3, vec![0, 1, 6, 7]), (3, 2, vec![0, 1, 6, 7])]);
    }
}
