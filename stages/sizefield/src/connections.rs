//! Adjacency of surface samples by triangle edges.

/// The neighbours of all samples, in one array.
#[derive(Clone, Debug)]
pub struct Connections {
    start: Vec<u32>,
    neighbours: Vec<u32>,
}

impl Connections {
    /// Finds the neighbours of each sample along the edges of the triangles. `samples` is the
    /// number of samples.
    pub fn new(samples: usize, triangles: &[[u32; 3]]) -> Self {
        // the two triangles at an edge traverse it in opposite directions, so storing one direction
        // per triangle gives every neighbour once; a boundary edge of an open surface is stored in
        // one direction only
        let mut start = vec![0u32; samples + 1];
        for t in triangles {
            t.iter().for_each(|&v| start[v as usize + 1] += 1);
        }
        for v in 0..samples {
            start[v + 1] += start[v];
        }
        let mut next = start.clone();
        let mut neighbours = vec![0; 3 * triangles.len()];
        for t in triangles {
            for (from, to) in [(t[0], t[1]), (t[1], t[2]), (t[2], t[0])] {
                neighbours[next[from as usize] as usize] = to;
                next[from as usize] += 1;
            }
        }
        Self { start, neighbours }
    }

    /// Returns the neighbours of a sample.
    pub fn of(&self, sample: usize) -> &[u32] {
        &self.neighbours[self.start[sample] as usize..self.start[sample + 1] as usize]
    }
}
