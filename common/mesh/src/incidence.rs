//! The triangles at each vertex, and by them edges, fans and Euler characteristics. Found by counting, not by sorting: the refinement asks
//! for all of them in each of its rounds.

use crate::buckets::Buckets;
use rayon::prelude::*;

/// Vertices whose edges are counted by one thread at a time: so few that those of a small mesh make a chunk for each.
const CHUNK: usize = 1 << 11;

/// Memory of [`Incidence::fans_at`], to be used again for the next vertex.
#[derive(Default)]
pub struct FanWork {
    /// (other end of an edge at the vertex, place of its triangle).
    ends: Vec<(u32, u32)>,
    /// Fan of each triangle.
    fan: Vec<u32>,
}

/// The triangles at each vertex of a list of triangles.
pub struct Incidence<'a> {
    triangles: &'a [[u32; 3]],
    /// Where the triangles of each vertex start in `at_vertex`, and one more.
    starts: Vec<u32>,
    at_vertex: Vec<u32>,
}

impl<'a> Incidence<'a> {
    /// Of triangles whose vertices are below `vertex_count`.
    pub fn new(triangles: &'a [[u32; 3]], vertex_count: usize) -> Self {
        let Buckets { starts, items } = Buckets::new(triangles.as_flattened(), vertex_count);
        // an item is a corner
        let at_vertex = items.into_par_iter().map(|corner| corner / 3).collect();
        Self { triangles, starts, at_vertex }
    }

    /// The triangles.
    pub fn triangles(&self) -> &'a [[u32; 3]] {
        self.triangles
    }

    /// The triangles at a vertex, in ascending order.
    pub fn of(&self, vertex: u32) -> &[u32] {
        let v = vertex as usize;
        &self.at_vertex[self.starts[v] as usize..self.starts[v + 1] as usize]
    }

    /// Vertices, those of no triangle included.
    pub fn vertex_count(&self) -> usize {
        self.starts.len() - 1
    }

    /// Tells `hear` each edge from a vertex to one of a larger number, with its triangles, all in ascending order.
    fn edges_from(&self, vertex: u32, ends: &mut Vec<(u32, u32)>, mut hear: impl FnMut(u32, &[(u32, u32)])) {
        ends.clear();
        for &t in self.of(vertex) {
            let others = self.triangles[t as usize].into_iter().filter(|&other| other > vertex);
            ends.extend(others.map(|other| (other, t)));
        }
        ends.sort_unstable();
        ends.chunk_by(|a, b| a.0 == b.0).for_each(|edge| hear(edge[0].0, edge));
    }

    /// Number of fans of triangles at a vertex, joined across the edges at it that lie in two triangles: one for a vertex of a manifold, none
    /// for a vertex of no triangle. Edges in another number of triangles join nothing and go to `other_edge`, by their other ends,
    /// with their triangles.
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

    /// Euler characteristic V - E + F of each class of triangles; `class` gives that of each triangle, below `classes`.
    pub fn euler_characteristics(&self, class: &[u32], classes: usize) -> Vec<i64> {
        let chunks = (0..self.vertex_count()).into_par_iter().step_by(CHUNK);
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
            for v in first as u32..(first + CHUNK).min(self.vertex_count()) as u32 {
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
