//! Walks from umbrella to umbrella across surface triangles, and orients the normals of each sheet
//! consistently. A sheet is a connected set of umbrellas.

use super::cells::Cells;
use super::umbrellas::Umbrellas;
use isoparticles_delaunay::INFINITE;
use rayon::prelude::*;

/// The sheet of each vertex, and the orientation of each normal.
pub(super) struct Sheets {
    /// Sheet of each vertex: the number of its first vertex.
    pub(super) sheet: Vec<u32>,
    /// Orientation of the normal of each vertex relative to its sheet: 1 equal, -1 opposite.
    pub(super) sense: Vec<i8>,
    /// Orientation of each sheet, at the number of its first vertex: 1 outward, -1 inward, 0
    /// unknown.
    pub(super) outward: Vec<i8>,
}

/// Two vertices that surface triangles connect.
struct Link {
    /// Net share of the common tetrahedra that have equal (or opposite) sides at both ends, in
    /// thousandths. Then the cosine between the normals, up to sign, in millionths. Integers make
    /// the links sortable.
    agreement: (u32, u32),
    ends: [u32; 2],
    /// Whether the normals have the same orientation.
    same: bool,
}

impl Sheets {
    /// Follows the links in descending order of agreement, as a maximum spanning forest. The hull
    /// determines the orientation of the sheets that reach it.
    pub(super) fn walk(cells: &Cells, umbrellas: &Umbrellas) -> Self {
        let count = cells.stars.vertex_count();
        let mut links: Vec<Link> =
            (0..count as u32).into_par_iter().flat_map_iter(|v| links_of(cells, umbrellas, v)).collect();
        links.par_sort_unstable_by_key(|link| (std::cmp::Reverse(link.agreement), link.ends));
        let mut sets = SignedSets { parent: (0..count as u32).map(|v| (v, 1)).collect() };
        for link in links {
            sets.join(link.ends, if link.same { 1 } else { -1 });
        }
        let (sheet, sense): (Vec<u32>, Vec<i8>) = (0..count as u32).map(|v| sets.find(v)).unzip();
        let mut votes = vec![0i64; count];
        for v in (0..count).filter(|&v| umbrellas.is_good[v]) {
            votes[sheet[v] as usize] += i64::from(sense[v] * cells.hull_side[v]);
        }
        let outward = votes.iter().map(|votes| votes.signum() as i8).collect();
        Self { sheet, sense, outward }
    }

    /// Returns a single sheet whose normals all have the given orientation: 1 outward, -1 inward.
    pub(super) fn given(count: usize, sense: i8) -> Self {
        Self { sheet: vec![0; count], sense: vec![1; count], outward: vec![sense; count] }
    }

    /// Returns the orientation of the normal at a vertex: 1 outward, -1 inward, 0 unknown.
    pub(super) fn sense_of(&self, v: u32) -> i8 {
        self.sense[v as usize] * self.outward[self.sheet[v as usize] as usize]
    }
}

/// Returns the links of a vertex with an umbrella to vertices with a higher number.
fn links_of(cells: &Cells, umbrellas: &Umbrellas, v: u32) -> Vec<Link> {
    if !umbrellas.is_good[v as usize] {
        return Vec::new();
    }
    let others = |t: u32| {
        let vertices = cells.delaunay.vertices(t);
        let is_wanted = move |w: u32| w != INFINITE && w > v && umbrellas.is_good[w as usize];
        (0..4).map(move |k| (k, vertices[k])).filter(move |&(_, w)| is_wanted(w))
    };
    // vertices w for which a candidate triangle at the edge v w separates the sides at both v and w
    let mut joined: Vec<u32> = Vec::new();
    for (t, side) in umbrellas.star(cells, v) {
        let (vertices, neighbours) = (cells.delaunay.vertices(t), cells.delaunay.neighbours(t));
        for j in (0..4).filter(|&j| vertices[j] != v && cells.is_candidate(t, j)) {
            if umbrellas.side(cells, v, neighbours[j]) == side {
                continue;
            }
            let parts = |w: u32| umbrellas.side(cells, w, neighbours[j]) != umbrellas.side(cells, w, t);
            joined.extend(others(t).filter(|&(k, w)| k != j && parts(w)).map(|(_, w)| w));
        }
    }
    joined.sort_unstable();
    joined.dedup();
    // for each of these edges: its tetrahedra, and those with equal sides at both ends minus those
    // with opposite sides
    let mut counts = vec![(0u32, 0i32); joined.len()];
    for (t, side) in umbrellas.star(cells, v) {
        for (_, w) in others(t) {
            if let Ok(at) = joined.binary_search(&w) {
                counts[at].0 += 1;
                counts[at].1 += i32::from(side) * i32::from(umbrellas.side(cells, w, t));
            }
        }
    }
    let link = |(&w, &(count, agreement)): (&u32, &(u32, i32))| {
        let parallel = cells.normals[v as usize].dot(cells.normals[w as usize]).abs();
        let agreed = agreement.unsigned_abs();
        (2 * agreed >= count).then_some(Link {
            agreement: (1000 * agreed / count, (parallel.min(1.0) * 1e6) as u32),
            ends: [v, w],
            same: agreement > 0,
        })
    };
    joined.iter().zip(&counts).filter_map(link).collect()
}

/// Union-find structure that stores the sign of each member relative to the smallest member of its
/// set.
struct SignedSets {
    parent: Vec<(u32, i8)>,
}

impl SignedSets {
    fn find(&mut self, v: u32) -> (u32, i8) {
        let (mut at, mut sign) = (v, 1);
        while self.parent[at as usize].0 != at {
            let (above, one) = self.parent[at as usize];
            let (top, two) = self.parent[above as usize];
            self.parent[at as usize] = (top, one * two);
            (at, sign) = (top, sign * self.parent[at as usize].1);
        }
        (at, sign)
    }

    fn join(&mut self, [a, b]: [u32; 2], sign: i8) {
        let ((a, a_sign), (b, b_sign)) = (self.find(a), self.find(b));
        if a != b {
            self.parent[a.max(b) as usize] = (a.min(b), a_sign * b_sign * sign);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn signs_do_not_depend_on_the_order_of_links() {
        let links = [([0u32, 1], -1i8), ([2, 3], 1), ([1, 2], -1), ([4, 5], -1), ([3, 4], 1), ([0, 5], 1)];
        let signs = |links: &[([u32; 2], i8)]| {
            let mut sets = SignedSets { parent: (0..7).map(|v| (v, 1)).collect() };
            links.iter().for_each(|&(ends, sign)| sets.join(ends, sign));
            (0..7).map(|v| sets.find(v)).collect::<Vec<_>>()
        };
        let forth = signs(&links[..5]);
        assert_eq!(forth, [(0, 1), (0, -1), (0, 1), (0, 1), (0, 1), (0, -1), (6, 1)]);
        let back: Vec<_> = links[..5].iter().rev().copied().collect();
        assert_eq!(signs(&back), forth);
    }
}
