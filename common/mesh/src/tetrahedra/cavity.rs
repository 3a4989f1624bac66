//! Searches for a better filling of a cavity around a poor tetrahedron.
//!
//! The cavity is replaced by the star of one point (see [`super::patch`]). If the point is a vertex
//! of the cavity, this is a flip or the removal of an edge. If it is a new vertex, the vertices
//! inside the cavity vanish, so a cavity around one vertex moves this vertex. A cavity grows by the
//! tetrahedron behind the worst face, as in Klingner and Shewchuk, "Aggressive tetrahedral mesh
//! improvement" (2007).

use super::patch::{Apex, Face, Filling, Patch};
use super::target::{AT_LIMIT, Targets};
use glam::DVec3;

// Measured on thorax_labels at 3 mm without a scale (7.8 million tetrahedra, 186 poor, 108 of them
// below a limit of the checks). The constants below leave 29 poor tetrahedra, 8 of them below a
// limit.

/// Number of sizes of a cavity that are tried. 10 leave 33 and 7 in three times the time.
const GROWTH: usize = 6;

/// Steps of the search for a place. A step that finds no better place halves the next. 10 leave 32
/// and 7, and 20 leave 33 and 6 in twice the time.
const STEPS: usize = 14;

/// Length of the first step in mean edges. 0.6 leaves 35 (with 10 steps).
const FIRST_STEP: f64 = 0.3;

/// Minimum relative decrease of the badness of a cavity. It prevents moves that only change
/// rounding errors. With 10 steps, 0.01 to 0.1 leave 31 or 32.
const GAIN: f64 = 0.02;

/// Weight of the deficits below the limits of the checks. 30 leaves 30 and 10; 4 leaves 32 (with 10
/// steps).
const FAILING_WEIGHT: f64 = 16.0;

/// Returns the badness of tetrahedra with these scores: the sum of their squared deficits. It is 0
/// if all tetrahedra reach their targets, and infinite if one is not positive.
fn badness(scores: impl Iterator<Item = f64>) -> f64 {
    let of_one = |score: f64| {
        if score <= 0.0 {
            return f64::INFINITY;
        }
        let failing = (AT_LIMIT - score).max(0.0);
        (1.0 - score).powi(2) + FAILING_WEIGHT * failing.powi(2)
    };
    scores.map(of_one).sum()
}

/// A face of a cavity, and the targets of the tetrahedron between it and a new vertex.
struct Base {
    /// Clockwise as seen from outside.
    corners: [DVec3; 3],
    targets: Targets,
}

impl Base {
    #[inline]
    fn score(&self, apex: DVec3) -> f64 {
        let [a, b, c] = self.corners;
        self.targets.score(&[a, b, c, apex])
    }
}

impl Patch {
    /// Returns the cavities at which the search begins: the tetrahedra around each edge, each face
    /// and each vertex of a tetrahedron, and the tetrahedron alone.
    fn cavities(&self, number: u32) -> Vec<Vec<u32>> {
        let cell = &self.cells[number as usize];
        let [a, b, c, d] = cell.vertices;
        let edges = [[a, b], [a, c], [a, d], [b, c], [b, d], [c, d]];
        let faces = [[a, b, c], [a, b, d], [a, c, d], [b, c, d]];
        let edges = edges.iter().map(|edge| &edge[..]);
        let simplices = edges.chain(faces.iter().map(|face| &face[..])).chain(cell.vertices.chunks(1));
        simplices.map(|simplex| self.around(simplex, cell.part)).chain([vec![number]]).collect()
    }

    /// Returns the filling around a tetrahedron that reduces the badness most, or `None` if none
    /// reduces it by [`GAIN`]. Stops at the first cavity with a filling that reaches all targets.
    pub(super) fn better_filling(&self, number: u32) -> Option<Filling> {
        let mut best: Option<(f64, Filling)> = None;
        for cavity in self.cavities(number) {
            if best.as_ref().is_some_and(|(_, filling)| filling.faces.iter().all(|&(_, score)| score >= 1.0)) {
                break;
            }
            self.each_filling(cavity, |filling| {
                let before = badness(filling.cavity.iter().map(|&n| self.cells[n as usize].score));
                let after = badness(filling.faces.iter().map(|&(_, score)| score));
                let gain = before - after;
                if after < (1.0 - GAIN) * before && best.as_ref().is_none_or(|best| gain > best.0) {
                    best = Some((gain, filling));
                }
            });
        }
        best.map(|(_, filling)| filling)
    }

    /// Calls `found` with fillings of a cavity and of the larger cavities that are grown from it.
    fn each_filling(&self, mut cavity: Vec<u32>, mut found: impl FnMut(Filling)) {
        let part = self.cells[cavity[0] as usize].part;
        self.flips(&cavity, part, &mut found);
        let corners = cavity.iter().flat_map(|&n| self.positions(self.cells[n as usize].vertices));
        let mut place = corners.sum::<DVec3>() / (4 * cavity.len()) as f64;
        for _ in 0..GROWTH {
            let faces = self.faces(&cavity);
            let scores;
            (place, scores) = self.search(&faces, part, place);
            let scored = faces.iter().zip(&scores).map(|(face, &score)| (face.vertices, score)).collect();
            found(Filling { cavity: cavity.clone(), apex: Apex::New(place), faces: scored });
            let mut order: Vec<usize> = (0..faces.len()).filter(|&k| scores[k] < 1.0).collect();
            order.sort_by(|&a, &b| scores[a].total_cmp(&scores[b]));
            match order.into_iter().find_map(|k| self.across(&faces[k])) {
                Some(other) => cavity.push(other),
                None => return,
            }
        }
    }

    /// Calls `found` with the positive stars of the vertices of a cavity.
    fn flips(&self, cavity: &[u32], part: u32, found: &mut impl FnMut(Filling)) {
        let faces = self.faces(cavity);
        let mut apexes: Vec<u32> = faces.iter().flat_map(|face| face.vertices).collect();
        apexes.sort_unstable();
        apexes.dedup();
        for apex in apexes {
            let others = faces.iter().map(|face| face.vertices).filter(|face| !face.contains(&apex));
            let scored = others.map(|face| {
                let [a, b, c] = face;
                let vertices = [a, c, b, apex];
                let score = self.targets(vertices, part).score(&self.positions(vertices));
                (score > 0.0).then_some((face, score))
            });
            if let Some(faces) = scored.collect::<Option<Vec<_>>>() {
                found(Filling { cavity: cavity.to_vec(), apex: Apex::Vertex(apex), faces });
            }
        }
    }

    /// Searches for the place whose star has the best minimum score, by a pattern search. Returns
    /// the place and the scores of its star.
    fn search(&self, faces: &[Face], part: u32, start: DVec3) -> (DVec3, Vec<f64>) {
        let base = |face: &Face| {
            let [a, b, c] = self.positions(face.vertices);
            Base { corners: [a, c, b], targets: self.targets_on(face.vertices, part) }
        };
        let bases: Vec<Base> = faces.iter().map(base).collect();
        let perimeter = |base: &Base| {
            let [a, b, c] = base.corners;
            a.distance(b) + b.distance(c) + c.distance(a)
        };
        let mut step = FIRST_STEP * bases.iter().map(perimeter).sum::<f64>() / (3 * bases.len()) as f64;
        // the order in which faces are tested: a face that falls short moves to the front
        let mut order: Vec<u32> = (0..bases.len() as u32).collect();
        let mut minimum = |place: DVec3, bound: f64| {
            let mut least = f64::INFINITY;
            for k in 0..order.len() {
                least = least.min(bases[order[k] as usize].score(place));
                if least <= bound {
                    order[..=k].rotate_right(1);
                    break;
                }
            }
            least
        };
        let (mut place, mut best) = (start, minimum(start, f64::NEG_INFINITY));
        for _ in 0..STEPS {
            let centre = place;
            let before = best;
            for n in (0..27).filter(|&n| n != 13) {
                let direction = DVec3::new((n % 3) as f64, (n / 3 % 3) as f64, (n / 9) as f64) - DVec3::ONE;
                let tried = centre + step * direction.normalize();
                let least = minimum(tried, best);
                if least > best {
                    (place, best) = (tried, least);
                }
            }
            if best >= 1.0 {
                break;
            }
            if best <= before {
                step *= 0.5;
            }
        }
        (place, bases.iter().map(|base| base.score(place)).collect())
    }
}
